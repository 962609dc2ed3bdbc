#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

namespace manip3d::relief_detail {

/// Which pixels on a triangle's sides count as inside.
enum class Edges : std::uint8_t {
  kShared,  ///< Those of each side for one of the two triangles that meet there.
  kOpen,    ///< None.
  kClosed,  ///< All.
};

/// Calls visit(pixel) for each pixel in a triangle (counter-clockwise with v up), row by row.
/// Pixel (u, v) has the number v * cols + u. Exact in integers up to 16 384 pixels a side.
template <typename Visit>
void visit_pixels(int cols, std::array<std::int32_t, 2> a, std::array<std::int32_t, 2> b,
                  std::array<std::int32_t, 2> c, Edges edges, Visit&& visit) {
  // A pixel is inside of side k if rise * u <= value (value - rise_v * (v - v0)).
  struct Side {
    std::int32_t rise, step, value;
  };
  const std::int32_t v0 = std::min({a[1], b[1], c[1]}), v1 = std::max({a[1], b[1], c[1]});
  const auto side = [&](const std::array<std::int32_t, 2>& p,
                        const std::array<std::int32_t, 2>& q) {
    const std::int32_t du = q[0] - p[0], dv = q[1] - p[1];
    // Of two triangles on either side the one that goes down or, if level, to the right has it.
    const bool inside =
        edges == Edges::kClosed || (edges == Edges::kShared && (dv < 0 || (dv == 0 && du > 0)));
    return Side{dv, du, du * (v0 - p[1]) + dv * p[0] - (inside ? 0 : 1)};
  };
  std::array<Side, 3> sides = {side(a, b), side(b, c), side(c, a)};
  for (std::int32_t v = v0; v <= v1; ++v) {
    std::int32_t from = 0, to = cols - 1;
    for (Side& s : sides) {
      if (s.rise > 0) {  // floor: value may be negative only where the row is empty
        to = std::min(to, s.value >= 0 ? s.value / s.rise : -1);
      } else if (s.rise < 0) {
        from = std::max(from, s.value < 0 ? (-s.value - s.rise - 1) / -s.rise : 0);
      } else if (s.value < 0) {
        to = -1;
      }
      s.value += s.step;
    }
    for (std::int32_t u = from; u <= to; ++u) visit(v * cols + u);
  }
}

}  // namespace manip3d::relief_detail
