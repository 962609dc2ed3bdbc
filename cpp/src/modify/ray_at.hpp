#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "manip3d/geometry/camera.hpp"

namespace manip3d {

/// The point of a pixel at depth z.
inline Eigen::Vector3f lift(const PixelRays& rays, std::int64_t u, std::int64_t v, float z) {
  const float y = rays.is_separable() ? *rays.y(v) : rays.y(v)[u];
  return {rays.x(v)[u] * z, y * z, z};
}

/// Whether a pixel has a usable ray: not NaN and not nearly orthogonal to the optical axis.
inline bool has_ray(const PixelRays& rays, std::int64_t u, std::int64_t v) {
  constexpr float kSteepest = 1e3F;
  const Eigen::Vector3f ray = lift(rays, u, v, 1.0F);
  return std::abs(ray.x()) + std::abs(ray.y()) < kSteepest;
}

}  // namespace manip3d
