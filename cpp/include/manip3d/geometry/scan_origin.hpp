#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Position of a scanner and the angular grid on which its points stand, seen from there.
struct ScanOrigin {
  bool found = false;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< Metres, in the frame of the points.
  int axis = 2;  ///< 0, 1, 2: azimuth is counted about x, y or z.

  /// Radians between columns and between rows of the grid; 0: none were found.
  double azimuth_step = 0.0;
  double elevation_step = 0.0;

  /// Agreement of points within 16 columns (rows) of each other on where columns (rows) are. A
  /// point's phase is its angle over the step, in turns; this is the mean cosine of the differences
  /// of phase over pairs of points. 1: all points stand on the grid, 0: phases are random.
  double azimuth_coherence = 0.0;
  double elevation_coherence = 0.0;

  /// Share of the points that stand on this grid, as the mean over tiles of 4 degrees. A cloud
  /// fused from two positions has about half, a scan with an object pasted into it nearly all.
  double explained = 0.0;
};

struct ScanOriginOptions {
  std::optional<Eigen::Vector3d> known = {};  ///< Judge this position only.
  /// Try (0, 0, 0) first, as the place of the scanner in its own coordinates. In those of a map,
  /// moved by a round number, it is no more likely than any other.
  bool tries_zero = true;
  int num_threads = 0;
};

/// Finds the position from which a scan stands on a grid of azimuth and elevation.
///
/// (0, 0, 0) is tried first, unless the options say otherwise. Then the first guess is the position
/// from which every patch of surface has the number of points that its solid angle calls for; it is
/// right to some per cent of the range. Gauss-Newton steps then make the phases of the grid agree.
/// Phases are compared within windows of 8 columns at first, over which a wrong position hardly
/// shifts them, and the window is doubled as long as they agree, to 256 columns at most. The polar
/// axis may be x, y or z.
///
/// `found` is false for clouds of two scanners, of scanners without such a grid, and for clouds
/// that were tilted; also where only azimuth columns were found, which leave the height
/// undetermined. Looks at up to 400 000 points in any order; the result is the same for any number
/// of threads.
/// @throws InputError  what check_points refuses; a known position that is not finite.
ScanOrigin estimate_scan_origin(const PointsView& view, const ScanOriginOptions& options = {},
                                const Progress& progress = {});

}  // namespace manip3d
