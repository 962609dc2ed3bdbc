#pragma once

#include <Eigen/Core>

#include "manip3d/geometry/camera.hpp"

namespace manip3d {

/// Return x/z and y/z of the line of sight through a point (u, v) of the image, which may lie
/// between pixels. A ray table is interpolated between the four nearest pixels and extrapolated by
/// up to half a pixel beyond the outermost ones. NaN where a distorted lens or a table has no line
/// of sight.
Eigen::Vector2d line_of_sight(const Intrinsics& camera, const Eigen::Vector2d& pixel);

/// The inverse of line_of_sight(): like project(), but with the camera's ray table if it has one.
/// NaN for z <= 0, and where the table has no pixel for the point.
Eigen::Vector2d pixel_of(const Intrinsics& camera, const Eigen::Vector3d& point);

}  // namespace manip3d
