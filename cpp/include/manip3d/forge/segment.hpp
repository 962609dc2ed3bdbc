#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct SegmentOptions {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< Position of the scanner, metres.
  double max_range = 80.0;       ///< Metres, horizontal distance; farther points are left out.
  double ground_height = 0.3;    ///< Metres above the ground: lower points belong to the ground.
  double ground_slope = 0.3;     ///< Steepest ground, as rise over horizontal distance.
  double tolerance = 0.5;        ///< Metres: gap that separates two objects.
  std::int64_t min_points = 30;  ///< Fewest points of an object.
  double max_size = 8.0;  ///< Metres: a longer cluster, for example a wall, is not an object.
};

struct Segmentation {
  /// (N,): an index of `boxes`, kGround, or kOther (too few points, too large, or too far).
  std::vector<std::int32_t> labels;
  std::vector<OrientedBox> boxes;  ///< Boxes by distance from the scanner, the nearest first.
  static constexpr std::int32_t kGround = -1;
  static constexpr std::int32_t kOther = -2;
};

/// Finds the objects that stand on the ground.
///
/// The ground is the lower envelope, no steeper than `ground_slope`, of the lowest points of 1 m
/// cells, after a median of 3x3 cells that removes single echoes from below. Points above it are
/// clustered: points in the same or in touching cubes with side `tolerance` belong together. The
/// yaw of each box gives the smallest footprint, to 2 degrees.
/// @throws InputError  the points fail check_points; an option out of range.
Segmentation segment_objects(const PointsView& scene, const SegmentOptions& options = {},
                             const Progress& progress = {});

}  // namespace manip3d
