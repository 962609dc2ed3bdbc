#pragma once

#include <array>
#include <cstdint>

#include "geometry/lanes.hpp"

namespace manip3d {

/// A vertex with the quadric of the planes that it represents, relative to the vertex itself: a
/// point at the offset u has Q(u) = u'Au + 2b'u + c [Garland & Heckbert 1997]. In these coordinates
/// single precision is enough at any distance from the origin, because b and c are as small as the
/// error.
template <typename Real>
struct QuadricVertexOf {
  Real x, y, z, unused_w;
  Real xx, xy, xz, yy;
  Real yz, zz, bx, by;
  Real bz, c, weight, unused;
};
struct alignas(64) QuadricVertex : QuadricVertexOf<float> {};  // one cache line
static_assert(sizeof(QuadricVertex) == 64);

/// Weight of a pull of the new vertex to the middle of its edge. It matters only where the quadric
/// has no unique minimum, and keeps the equations solvable in single precision (condition below
/// 1e5).
inline constexpr float kPullToMiddle = 3e-5F;

/// On flat regions every price is rounding noise; with this share of the squared length, short
/// edges collapse first there.
inline constexpr float kShortEdgePreference = 1e-9F;

#define MANIP3D_EDGE_QUADRIC EdgeQuadric
#include "simplify/edge_quadric.inc"
#undef MANIP3D_EDGE_QUADRIC

/// Transposes four vertices into one with four numbers per member.
inline QuadricVertexOf<Float4> transpose(const std::array<const QuadricVertex*, 4>& v) {
  QuadricVertexOf<Float4> out;
  Float4* to = &out.x;
  for (int row = 0; row < 4; ++row) {
    const auto of = [&](std::size_t i) { return reinterpret_cast<const Float4*>(v[i])[row]; };
    for (const Float4& column : transpose({of(0), of(1), of(2), of(3)})) *to++ = column;
  }
  return out;
}

}  // namespace manip3d
