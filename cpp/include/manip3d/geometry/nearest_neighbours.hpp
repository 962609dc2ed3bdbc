#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct NearestOptions {
  /// Position of the scanner. Without it, or where the directions from it are too crowded to help,
  /// a k-d tree answers.
  std::optional<Eigen::Vector3d> origin = Eigen::Vector3d::Zero();
  double resolution = 0.0;  ///< Radians, of the search cells; 0: one point a cell on average.
  int num_threads = 0;      ///< 0: all cores.
};

/// Euclidean distance of each point from its nearest other point, in double; infinite for a lone
/// point, 0 for duplicates.
///
/// Exact whatever the options: points are binned by their direction from the origin, and cells are
/// looked at in turn until no other can hold a nearer point. Two facts bound what is left out: a
/// point whose elevation differs by e (at most 90 degrees) from that of a point at range r is at
/// least r sin e away, and one whose azimuth differs by a is at least rho sin a away, rho being the
/// distance from the vertical axis. Scans of one position, in any order, take O(N) time. 40 bytes a
/// point.
/// @throws InputError  what check_points refuses; an origin that is not finite; resolution < 0.
LargeArray<double> nearest_distances(const PointsView& view, const NearestOptions& options = {},
                                     const Progress& progress = {});

}  // namespace manip3d
