#pragma once

#include <Eigen/Core>

/// @file
/// Exact predicates [Shewchuk, Discrete & Computational Geometry 1997] for coordinates that are 0
/// or have a magnitude between 1e-90 and 1e90, so that products of three of them neither overflow
/// nor lose bits to underflow. The predicates do not check this; callers must reject points for
/// which is_exact() is false (which includes NaN and infinity).

namespace manip3d {

/// Whether the coordinates of a point are in the range above.
bool is_exact(const Eigen::Vector3d& point);

/// Sign of the area of a triangle in the plane: 1 if a, b, c are counter-clockwise, 0 if they lie
/// on one line.
int orientation(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c);

/// Whether three points lie on one line; true where some of them are equal.
bool are_collinear(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c);

/// Whether four points lie in one plane; true where three of them lie on one line.
bool are_coplanar(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c,
                  const Eigen::Vector3d& d);

}  // namespace manip3d
