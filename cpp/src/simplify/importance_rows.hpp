#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

#include "geometry/always_inline.hpp"
#include "geometry/constants.hpp"
#include "simplify/importance_map.hpp"

namespace manip3d {

struct PointRow {
  float *x, *y, *z;
};

// condition ? a : b, without a branch.
MANIP3D_INLINE float choose(bool condition, float a, float b) {
  const std::uint32_t mask = 0U - static_cast<std::uint32_t>(condition);
  return std::bit_cast<float>((std::bit_cast<std::uint32_t>(a) & mask) |
                              (std::bit_cast<std::uint32_t>(b) & ~mask));
}

/// A of two differences of points (eq. 3.1, 3.2).
MANIP3D_INLINE float area_of(float ax, float ay, float az, float bx, float by, float bz) {
  const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
  const float length_n = std::sqrt(nx * nx + ny * ny + nz * nz);
  return length_n / ((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz));
}

struct Hessian {
  float uu, vv, uv;
};

/// A in five rows around that of the pixel.
struct AreaRows {
  const float *up2, *up, *row, *down, *down2;
};

// Omega(u); unknown values count as flat.
template <Cs3Importance importance>
MANIP3D_INLINE float importance_of(const Hessian& m) {
  float omega = m.uu + m.vv;
  if constexpr (importance == Cs3Importance::kMinCurvature) {
    const float mean = 0.5F * (m.uu + m.vv), half = 0.5F * (m.uu - m.vv);
    omega = std::abs(mean - std::sqrt(half * half + m.uv * m.uv));
  }
  return choose(std::abs(omega) < kInfinityF, omega + 0.0F, 0.0F);  // + 0: no negative zero
}

/// The key of a pixel with this depth; kNoKey if the depth is NaN.
template <Cs3Importance importance>
MANIP3D_INLINE ImportanceKey key_of(const Hessian& m, float z) {
  // kNoKey: all bits set
  return to_key(importance_of<importance>(m)) | (0U - static_cast<std::uint32_t>(z != z));
}

// The same rows for other readings than the default one (Cs3Reading), computed more slowly.
void area_row_by(const Cs3Reading& reading, const PointRow& above, const PointRow& row,
                 const PointRow& below, std::int64_t width, float* area);
Hessian hessian_by(const Cs3Reading& reading, const AreaRows& a, std::int64_t u);
void importance_row_by(const Cs3Options& options, const AreaRows& areas, const float* z,
                       std::int64_t width, ImportanceKey* keys);
/// Half of the side of a blocked square, for a radius Rd.
std::int64_t rounded_by(Cs3Reading::Rounding rounding, double radius);

}  // namespace manip3d
