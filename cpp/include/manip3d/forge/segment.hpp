#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct SegmentOptions {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< The scanner's.
  double max_range = 80.0;       ///< Metres, over the ground; farther points are left out.
  double ground_height = 0.3;    ///< Metres above the ground at which objects begin.
  double ground_slope = 0.3;     ///< Steepest ground, as height over distance.
  double tolerance = 0.5;        ///< Metres: gap that separates two objects.
  std::int64_t min_points = 30;  ///< Fewest points of an object.
  double max_size = 8.0;         ///< Metres: a longer cluster (a wall) is not an object.
};

struct Segmentation {
  /// (N,): an index of `boxes`; kGround; or kOther (too few points, too large, too far).
  std::vector<std::int32_t> labels;
  std::vector<OrientedBox> boxes;  ///< By distance from the scanner, the nearest first.
  static constexpr std::int32_t kGround = -1;
  static constexpr std::int32_t kOther = -2;
};

/// Objects on the ground. The ground is the lower envelope, no steeper than `ground_slope`, of the
/// lowest points of 1 m cells (a median of 3x3 cells first, against single echoes from below); what
/// rises above it is clustered: points in the same or in touching cubes of side `tolerance` belong
/// together. Each box has the yaw, to 2 degrees, of the smallest footprint.
/// @throws InputError  what check_points refuses; an option out of range.
Segmentation segment_objects(const PointsView& scene, const SegmentOptions& options = {},
                             const Progress& progress = {});

}  // namespace manip3d
