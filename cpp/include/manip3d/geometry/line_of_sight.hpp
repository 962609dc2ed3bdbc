#pragma once

#include <Eigen/Core>

#include "manip3d/geometry/camera.hpp"

namespace manip3d {

/// x/z and y/z of the line of sight through a pixel (u, v), which need not be whole. A ray table
/// is interpolated between its four nearest pixels, and continued for half a pixel beyond its
/// outermost ones. NaN where a distorted lens or a table has no line of sight.
Eigen::Vector2d line_of_sight(const Intrinsics& camera, const Eigen::Vector2d& pixel);

/// The inverse of line_of_sight(): as project(), but by the ray table where the camera has one.
/// NaN for z <= 0, and where a table has no pixel for the point.
Eigen::Vector2d pixel_of(const Intrinsics& camera, const Eigen::Vector3d& point);

}  // namespace manip3d
