#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Where a scanner stood, as its angular grid tells.
struct ScanOrigin {
  bool found = false;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< Metres, in the frame of the points.
  int axis = 2;  ///< 0, 1, 2: azimuth is counted about x, y or z.

  /// Radians between columns and between rows of the grid; 0: none were found.
  double azimuth_step = 0.0;
  double elevation_step = 0.0;

  /// How well points within 16 columns (rows) of each other agree on where columns (rows) are: mean
  /// cosine of their differences in phase; 1: all of them, 0: none.
  double azimuth_coherence = 0.0;
  double elevation_coherence = 0.0;

  /// Share of the points that stand on this grid, as the mean over tiles of 4 degrees: of a cloud
  /// fused from two positions about half, with an object pasted in nearly all.
  double explained = 0.0;
};

/// Finds the position from which a scan stands on a grid of azimuth and elevation.
///
/// (0, 0, 0) is tried first. Otherwise a position is looked for from which every patch of surface
/// has as many points as its solid angle calls for, which is right to some per cent of the range;
/// from there it follows the phases of the grid: in windows of 8 columns they agree in spite of
/// such an error, and each time that they do, the window is widened, to 64 columns at last. The
/// polar axis may be any of the three.
///
/// Clouds of two scanners, of scanners without such a grid, or that were turned out of their
/// upright have no such position: `found` is false. So it is where only columns were found, which
/// do not tell the height. Looks at up to 400 000 points in any order; the same for any number of
/// threads.
/// @param known  judge this position only.
/// @throws InputError  what check_points refuses; a known position that is not finite.
ScanOrigin estimate_scan_origin(const PointsView& view,
                                const std::optional<Eigen::Vector3d>& known = {},
                                int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
