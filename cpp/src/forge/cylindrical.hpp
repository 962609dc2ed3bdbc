#pragma once

#include <Eigen/Core>
#include <cmath>

namespace manip3d {

/// Distance of `p` from the scanner's vertical axis.
inline double rho_of(const Eigen::Vector3d& p) { return std::sqrt(p.x() * p.x() + p.y() * p.y()); }

}  // namespace manip3d
