#pragma once

#include <Eigen/Core>

namespace manip3d {

/// Exact predicates for coordinates that are 0 or have a magnitude between 1e-90 and 1e90
/// [Shewchuk, Discrete & Computational Geometry 1997]; others are refused by their caller.

/// Whether the coordinates of a point are in the range above.
bool is_exact(const Eigen::Vector3d& point);

/// Sign of the area of a triangle in the plane: 1 where it is counter-clockwise.
int orientation(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c);

bool are_collinear(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c);

bool are_coplanar(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c,
                  const Eigen::Vector3d& d);

}  // namespace manip3d
