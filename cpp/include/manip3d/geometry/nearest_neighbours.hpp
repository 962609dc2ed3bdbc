#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct NearestOptions {
  /// Position of the scanner. Without it, or if the directions from it are too crowded to be
  /// useful, a k-d tree is used.
  std::optional<Eigen::Vector3d> origin = Eigen::Vector3d::Zero();
  /// Size of the search cells, radians; 0: one point per cell on average.
  double resolution = 0.0;
  int num_threads = 0;  ///< 0: all cores.
};

/// Euclidean distance of each point from its nearest other point, in double; infinite for a lone
/// point, 0 for duplicates.
///
/// The result is exact for all options. Points are binned by their direction from the origin, and
/// cells are searched until no other cell can contain a nearer point. Two facts bound the distance
/// to the other cells: a point whose elevation differs by e (at most 90 degrees) from that of a
/// point at range r is at least r sin e away, and one whose azimuth differs by a is at least rho
/// sin a away, where rho is the distance from the vertical axis. Scans from one position, in any
/// order, take O(N) time. 40 bytes per point.
/// @throws InputError  as check_points; an origin that is not finite; resolution < 0.
LargeArray<double> nearest_distances(const PointsView& view, const NearestOptions& options = {},
                                     const Progress& progress = {});

}  // namespace manip3d
