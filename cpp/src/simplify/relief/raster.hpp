#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <utility>

namespace manip3d::relief_detail {

using PixelPlace = std::array<std::int32_t, 2>;  ///< Column and row.

/// Twice the signed area of a triangle.
inline std::int64_t doubled_area(const PixelPlace& a, const PixelPlace& b, const PixelPlace& c) {
  return std::int64_t{b[0] - a[0]} * (c[1] - a[1]) - std::int64_t{b[1] - a[1]} * (c[0] - a[0]);
}

/// Treatment of pixels on the sides of a triangle.
enum class SidePixels : std::uint8_t {
  kShared,  ///< A pixel on a side counts for one of the two triangles at that side.
  kOpen,    ///< Pixels on sides do not count.
  kClosed,  ///< All pixels on sides count.
};

/// Calls visit(first, last) for the pixels of each row in a triangle (counter-clockwise with v up).
/// Pixel (u, v) has the number v * cols + u. Exact in integers up to 16 384 pixels a side.
template <typename Visit>
void visit_spans(int cols, PixelPlace a, PixelPlace b, PixelPlace c, SidePixels edges,
                 Visit&& visit) {
  // A pixel of row v is inside of a side that rises by dv if dv * u <= value, where value is affine
  // in v. The quotient of value by |dv| and the remainder are updated from row to row.
  struct Side {
    std::int32_t dv, size, quotient, remainder, quotient_step, remainder_step;
    void next() {
      quotient += quotient_step;
      remainder += remainder_step;
      if (remainder >= size) remainder -= size, ++quotient;
    }
  };
  const std::int32_t v0 = std::min({a[1], b[1], c[1]}), v1 = std::max({a[1], b[1], c[1]});
  const auto side = [&](const PixelPlace& p, const PixelPlace& q) {
    const std::int32_t du = q[0] - p[0], dv = q[1] - p[1];
    // A pixel on a side belongs to the triangle for which the side goes down or, if horizontal, to
    // the right.
    const bool inside = edges == SidePixels::kClosed ||
                        (edges == SidePixels::kShared && (dv < 0 || (dv == 0 && du > 0)));
    const std::int32_t value = du * (v0 - p[1]) + dv * p[0] - (inside ? 0 : 1);
    Side s{dv, dv != 0 ? std::abs(dv) : 1, 0, 0, 0, 0};
    s.quotient = value / s.size;
    s.remainder = value % s.size;
    if (s.remainder < 0) s.remainder += s.size, --s.quotient;
    s.quotient_step = du / s.size;
    s.remainder_step = du % s.size;
    if (s.remainder_step < 0) s.remainder_step += s.size, --s.quotient_step;
    return s;
  };
  std::array<Side, 3> sides = {side(a, b), side(b, c), side(c, a)};
  for (std::int32_t v = v0; v <= v1; ++v) {
    std::int32_t from = 0, to = cols - 1;
    for (Side& s : sides) {
      if (s.dv > 0) {
        to = std::min(to, s.quotient);
      } else if (s.dv < 0) {
        from = std::max(from, -s.quotient);
      } else if (s.quotient < 0) {
        to = -1;
      }
      s.next();
    }
    if (from <= to) visit(v * cols + from, v * cols + to);
  }
}

/// Calls visit(pixel) for each pixel in a triangle.
template <typename Visit>
void visit_pixels(int cols, const PixelPlace& a, const PixelPlace& b, const PixelPlace& c,
                  SidePixels edges, Visit&& visit) {
  visit_spans(cols, a, b, c, edges, [&](std::int32_t first, std::int32_t last) {
    for (std::int32_t pixel = first; pixel <= last; ++pixel) visit(pixel);
  });
}

/// Calls visit(pixel, on_first, on_second) for the pixels in and on the triangle between a pixel,
/// one of its eight neighbours and a third pixel that is not on a line with them. `on_first` and
/// `on_second` tell whether it is on the side from the pixel, or from the neighbour, to the third
/// one. Works without divisions: column by column, or row by row if the triangle is higher than
/// wide.
/// @param step  From the pixel to its neighbour.
template <typename Visit>
void visit_sliver(std::int32_t cols, const PixelPlace& from, const PixelPlace& step,
                  const PixelPlace& end, Visit&& visit) {
  std::int32_t length = end[0] - from[0], rise = end[1] - from[1];
  std::int32_t dx = step[0], dy = step[1], right = 1, up = cols;
  if (std::abs(rise) > std::abs(length)) {
    std::swap(length, rise);
    std::swap(dx, dy);
    std::swap(right, up);
  }
  if (length < 0) length = -length, dx = -dx, right = -right;
  if (length * dy < rise * dx) rise = -rise, dy = -dy, up = -up;
  // Now the neighbour is above the first side, whose slope is -1 to 1.
  std::int32_t column = from[1] * cols + from[0];
  std::int32_t x = 0;
  if (dx < 0) visit(column - right + dy * up, false, true);
  if (dx > 0) {
    visit(column, true, false);
    x = 1;
    column += right;
  }
  // The lowest and the highest pixel of a column, and their distances above the first side and
  // below the second one, multiplied by the lengths of these sides.
  std::int32_t low = x == 0 ? 0 : rise > 0 ? 1 : rise == -length ? -1 : 0;
  std::int32_t above = low * length - x * rise;
  const std::int32_t top_length = length - dx, top_rise = rise - dy;
  std::int32_t high = dy, below = 0;
  const auto climb = [&] {
    below += top_rise;
    while (below < 0) below += top_length, --high;
    while (below >= top_length) below -= top_length, ++high;
  };
  if (dx < 0) climb();
  for (;; ++x, column += right) {
    for (std::int32_t y = low; y <= high; ++y) {
      visit(column + y * up, y == low && above == 0, top_length == 0 || (y == high && below == 0));
    }
    if (x == length) return;
    above -= rise;
    if (above < 0) above += length, ++low;
    if (above >= length) above -= length, --low;
    climb();
  }
}

}  // namespace manip3d::relief_detail
