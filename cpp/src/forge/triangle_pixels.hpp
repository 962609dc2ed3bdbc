#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "geometry/lanes.hpp"
#include "manip3d/geometry/range_image.hpp"

namespace manip3d {

/// A projected vertex: pixel coordinates and depth; NaN if it is behind the camera.
struct Drawn {
  float u = std::numeric_limits<float>::quiet_NaN();
  float v = std::numeric_limits<float>::quiet_NaN();
  float z = std::numeric_limits<float>::quiet_NaN();
};

/// First and last columns and rows of a box.
struct DrawBounds {
  float left, right, top, bottom;
  explicit DrawBounds(const PixelBox& box)
      : left(static_cast<float>(box.u0)),
        right(static_cast<float>(box.u0 + box.width - 1)),
        top(static_cast<float>(box.v0)),
        bottom(static_cast<float>(box.v0 + box.height - 1)) {}
};

/// Barycentric coordinates of four adjacent pixel centres of a row, and which of them are in the
/// triangle.
struct FourPixels {
  Int4 inside;
  Float4 a, b, c;
  [[nodiscard]] Float4 mix(float at_a, float at_b, float at_c) const {
    return a * at_a + b * at_b + c * at_c;
  }
};

/// Calls `use(u, v, four)` with groups of four pixels (u to u + 3, v) until all pixel centres of
/// the box that lie in the triangle or on its edges were in a group. It is fastest for triangles of
/// a few pixels: their rows are rarely longer than four.
template <typename Use>
void for_each_pixel(const Drawn& a, const Drawn& b, const Drawn& c, const DrawBounds& box,
                    const Use& use) {
  const float least_u = std::min({a.u, b.u, c.u}), most_u = std::max({a.u, b.u, c.u});
  const float least_v = std::min({a.v, b.v, c.v}), most_v = std::max({a.v, b.v, c.v});
  if (!(most_u >= box.left && least_u <= box.right && most_v >= box.top && least_v <= box.bottom)) {
    return;
  }
  const auto first = [](float least, float from) {  // std::ceil is a function call without SSE 4.1
    const float at = std::max(least, from);
    const auto whole = static_cast<std::int32_t>(at);
    return whole + (static_cast<float>(whole) < at ? 1 : 0);
  };
  const std::int32_t u0 = first(least_u, box.left), v0 = first(least_v, box.top);
  const auto u1 = static_cast<std::int32_t>(std::min(most_u, box.right));
  const auto v1 = static_cast<std::int32_t>(std::min(most_v, box.bottom));
  if (u0 > u1 || v0 > v1) return;
  const float bu = b.u - a.u, bv = b.v - a.v, cu = c.u - a.u, cv = c.v - a.v;
  const float area = bu * cv - bv * cu;
  // This also fails on NaN, which means that a corner is behind the camera.
  if (area == 0.0F || !(std::abs(area) < std::numeric_limits<float>::infinity())) return;
  // Barycentric coordinates are linear in the image.
  const float scale = 1.0F / area;
  const float b_du = cv * scale, b_dv = -cu * scale;
  const float c_du = -bv * scale, c_dv = bu * scale;
  // pixels on a common edge belong to both triangles, whatever the rounding
  constexpr float kEdge = -1e-4F;
  for (std::int32_t u = u0; u <= u1; u += 4) {
    const auto from = static_cast<float>(u);
    const Float4 pu = (from + Float4{0.0F, 1.0F, 2.0F, 3.0F}) - a.u;
    const Int4 in_box = (u1 - u) >= Int4{0, 1, 2, 3};
    const Float4 along_b = pu * b_du, along_c = pu * c_du;
    for (std::int32_t v = v0; v <= v1; ++v) {
      const float pv = static_cast<float>(v) - a.v;
      FourPixels four;
      four.b = pv * b_dv + along_b;
      four.c = pv * c_dv + along_c;
      four.a = 1.0F - four.b - four.c;
      four.inside = in_box & (four.a >= kEdge) & (four.b >= kEdge) & (four.c >= kEdge);
      use(u, v, four);
    }
  }
}

}  // namespace manip3d
