#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "geometry/always_inline.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {

/// Directions of a block of points as seen from an origin. The loops over plain arrays are
/// vectorized by compilers.
struct Directions {
  static constexpr std::int64_t kBlock = 256;

  float range[kBlock];      ///< Metres.
  float rho[kBlock];        ///< Metres from the vertical axis.
  float azimuth[kBlock];    ///< Radians in [-pi, pi].
  float elevation[kBlock];  ///< Radians in [-pi/2, pi/2].

  /// @param xyz     rows of three, `stride` floats apart.
  /// @param origin  Subtracted in double, so that a distant origin costs no precision.
  void compute(const float* xyz, std::int64_t stride, std::int64_t count,
               const Eigen::Vector3d& origin) {
    float x[kBlock];
    float y[kBlock];
    float z[kBlock];
    for (std::int64_t i = 0; i < count; ++i) {
      x[i] = static_cast<float>(xyz[stride * i] - origin.x());
      y[i] = static_cast<float>(xyz[stride * i + 1] - origin.y());
      z[i] = static_cast<float>(xyz[stride * i + 2] - origin.z());
    }
    for (std::int64_t i = 0; i < count; ++i) {
      const float level = x[i] * x[i] + y[i] * y[i];
      rho[i] = std::sqrt(level);
      range[i] = std::sqrt(level + z[i] * z[i]);
    }
    for (std::int64_t i = 0; i < count; ++i) azimuth[i] = angle_of(y[i], x[i]);
    for (std::int64_t i = 0; i < count; ++i) elevation[i] = angle_of(z[i], rho[i]);
  }

 private:
  // arc_tangent without branches.
  static float angle_of(float y, float x) {
    const float ax = std::abs(x);
    const float ay = std::abs(y);
    const float longer = std::max(std::max(ax, ay), 1e-37F);
    const float t = std::min(ax, ay) / longer;
    float angle = arc_tangent_of_unit(t);
    angle = ay > ax ? std::numbers::pi_v<float> / 2 - angle : angle;
    angle = x < 0.0F ? std::numbers::pi_v<float> - angle : angle;
    return std::copysign(angle, y);
  }
};

/// Direction of one point; units as in `Directions`.
struct Direction {
  float range, rho, azimuth, elevation;
};

/// Calls visit(i, direction) for the points [begin, end). Inlined, so that what `visit` captures is
/// not loaded again for each point.
/// @param xyz  rows of three of all points; see Directions::compute().
template <typename Visit>
MANIP3D_INLINE void for_each_direction(const float* xyz, std::int64_t stride, std::int64_t begin,
                                       std::int64_t end, const Eigen::Vector3d& origin,
                                       const Visit& visit) {
  Directions block;
  for (std::int64_t i = begin; i < end; i += Directions::kBlock) {
    const std::int64_t size = std::min(Directions::kBlock, end - i);
    block.compute(xyz + stride * i, stride, size, origin);
    for (std::int64_t k = 0; k < size; ++k) {
      visit(i + k, Direction{block.range[k], block.rho[k], block.azimuth[k], block.elevation[k]});
    }
  }
}

}  // namespace manip3d
