#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>

#include "manip3d/geometry/camera.hpp"

namespace manip3d {

inline bool is_distorted(const Intrinsics& camera) {
  return std::any_of(camera.distortion.begin(), camera.distortion.end(),
                     [](double k) { return k != 0.0; });
}

/// Brown, "Decentering distortion of lenses", 1966, with OpenCV's names of the coefficients.
inline Eigen::Vector2d distort(const std::array<double, 5>& k, const Eigen::Vector2d& ray) {
  const double x = ray.x(), y = ray.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  return {x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
          y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y};
}

/// x and y of the line of sight of a lens without distortion.
inline double ideal_x(const Intrinsics& camera, double u) {
  const double x = (u - camera.cx) / camera.fx;
  return camera.mirrored ? -x : x;
}
inline double ideal_y(const Intrinsics& camera, double v) { return (v - camera.cy) / camera.fy; }

}  // namespace manip3d
