#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// An upright box. `size` is its length, width and height along its own axes, which are rotated by
/// `yaw` radians about the vertical.
struct OrientedBox {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  Eigen::Vector3d size = Eigen::Vector3d::Zero();
  double yaw = 0.0;
};

/// @throws InputError  a number that is not finite; a negative size; a yaw beyond 1e6.
void check_box(const OrientedBox& box);

/// Return the rows of the points inside the box or on its boundary, ascending. Rows at exactly
/// (0, 0, 0) have no return and are left out.
/// @throws InputError  as check_points and check_box.
std::vector<std::int32_t> points_in_box(const PointsView& view, const OrientedBox& box,
                                        int num_threads = 0, const Progress& progress = {});

/// The smallest box with this yaw around the given rows; all zero if there are none.
OrientedBox box_around(const PointsView& view, const std::vector<std::int32_t>& rows,
                       double yaw = 0.0);

}  // namespace manip3d
