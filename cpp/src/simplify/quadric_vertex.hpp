#pragma once

#include <array>
#include <cstdint>

#include "geometry/lanes.hpp"

namespace manip3d {

/// A vertex with the quadric of the planes that it stands for, about the vertex itself: a point at
/// the offset u from it has Q(u) = u'Au + 2b'u + c [Garland & Heckbert 1997]. About the vertex,
/// single precision is enough however far away the origin is: b and c are as small as the error.
template <typename Real>
struct QuadricVertexOf {
  Real x, y, z, unused_w;
  Real xx, xy, xz, yy;
  Real yz, zz, bx, by;
  Real bz, c, weight, unused;
};
struct alignas(64) QuadricVertex : QuadricVertexOf<float> {};  // one line of the cache
static_assert(sizeof(QuadricVertex) == 64);

/// Pull of the middle of an edge on the new vertex: it decides only where the quadric does not,
/// and keeps the equations solvable in single precision (condition below 1e5).
inline constexpr float kPullToMiddle = 3e-5F;

/// On flat regions every price is rounding noise: short edges go first there.
inline constexpr float kShortEdgeFirst = 1e-9F;

/// The quadric of the two ends of an edge, about its first end, and where it is least.
template <typename Real>
struct EdgeQuadric {
  Real dx, dy, dz;  // from the first end to the second
  Real xx, xy, xz, yy, yz, zz, bx, by, bz, c, weight;
  Real ux, uy, uz;  // the best offset from the first end

  [[nodiscard]] Real value(Real x, Real y, Real z) const {
    return x * (xx * x + 2.0F * (xy * y + xz * z + bx)) + y * (yy * y + 2.0F * (yz * z + by)) +
           z * (zz * z + 2.0F * bz) + c;
  }

  EdgeQuadric(const QuadricVertexOf<Real>& v, const QuadricVertexOf<Real>& t)
      : dx(t.x - v.x),
        dy(t.y - v.y),
        dz(t.z - v.z),
        xx(v.xx + t.xx),
        xy(v.xy + t.xy),
        xz(v.xz + t.xz),
        yy(v.yy + t.yy),
        yz(v.yz + t.yz),
        zz(v.zz + t.zz),
        weight(v.weight + t.weight) {
    // Q_t about v: u - d for u.
    const Real adx = t.xx * dx + t.xy * dy + t.xz * dz;
    const Real ady = t.xy * dx + t.yy * dy + t.yz * dz;
    const Real adz = t.xz * dx + t.yz * dy + t.zz * dz;
    bx = v.bx + (t.bx - adx);
    by = v.by + (t.by - ady);
    bz = v.bz + (t.bz - adz);
    c = v.c +
        (t.c + (adx - 2.0F * t.bx) * dx + (ady - 2.0F * t.by) * dy + (adz - 2.0F * t.bz) * dz);
    minimize();
  }

  /// The price of the collapse: the area that the new vertex stands for times its mean square
  /// distance to the planes there.
  [[nodiscard]] Real price(Real value_there) const {
    return value_there + kShortEdgeFirst * weight * (dx * dx + dy * dy + dz * dz);
  }

 private:
  /// Solves (A + l I) u = l d / 2 - b by the factors L D L'.
  void minimize() {
    const Real l = kPullToMiddle * weight + 1e-30F;
    const Real d0 = xx + l, half = 0.5F * l;
    const Real r0 = 1.0F / d0;
    const Real l1 = xy * r0, l2 = xz * r0;
    const Real d1 = yy + l - l1 * xy, m = yz - l1 * xz;
    const Real r1 = 1.0F / d1;
    const Real l3 = m * r1;
    const Real d2 = zz + l - l2 * xz - l3 * m;
    const Real y0 = half * dx - bx;
    const Real y1 = half * dy - by - l1 * y0;
    const Real y2 = half * dz - bz - l2 * y0 - l3 * y1;
    uz = y2 / d2;
    uy = y1 * r1 - l3 * uz;
    ux = y0 * r0 - l1 * uy - l2 * uz;
  }
};

/// Turns four vertices into one with four numbers for each.
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
