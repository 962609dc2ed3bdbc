#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Position of a scanner, and the angular grid of its points as seen from there.
struct ScanOrigin {
  bool found = false;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< Metres, in the frame of the points.
  int axis = 2;  ///< 0, 1, 2: azimuth is measured about x, y or z.

  /// Radians between columns and between rows of the grid; 0: not found.
  double azimuth_step = 0.0;
  double elevation_step = 0.0;

  /// Agreement of points within 16 columns (rows) of each other on the positions of columns (rows).
  /// The phase of a point is its angle divided by the step, in turns; the coherence is the mean
  /// cosine of the differences of phase over pairs of points. 1: all points are on the grid, 0:
  /// phases are random.
  double azimuth_coherence = 0.0;
  double elevation_coherence = 0.0;

  /// Share of the points that are on this grid, averaged over tiles of 4 degrees. It is about a
  /// half for a cloud fused from two positions, and nearly 1 for a scan with a pasted object.
  double explained = 0.0;
};

struct ScanOriginOptions {
  std::optional<Eigen::Vector3d> known = {};  ///< Evaluate only this position.
  /// Try (0, 0, 0) first, because it is the place of the scanner in its own coordinates. In map
  /// coordinates it is no more likely than any other position.
  bool tries_zero = true;
  int num_threads = 0;
};

/// Estimate the position from which a scan lies on a grid of azimuth and elevation.
///
/// (0, 0, 0) is tried first, unless the options disable it. Otherwise the first estimate is the
/// position from which every patch of surface has the number of points that its solid angle
/// requires, which is accurate to some per cent of the range. Gauss-Newton steps then make the
/// phases of the grid agree. Phases are first compared within windows of 8 columns, in which a
/// wrong position hardly shifts them; the window is doubled while they agree, up to 256 columns.
/// The polar axis may be x, y or z.
///
/// `found` is false for clouds of two scanners, of scanners without such a grid, and for tilted
/// clouds; also if only azimuth columns were found, because they leave the height undetermined.
/// Uses up to 400 000 points in any order; the result is the same for any number of threads.
/// @throws InputError  as check_points; a known position that is not finite.
ScanOrigin estimate_scan_origin(const PointsView& view, const ScanOriginOptions& options = {},
                                const Progress& progress = {});

}  // namespace manip3d
