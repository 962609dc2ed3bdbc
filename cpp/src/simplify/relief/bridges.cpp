#include "simplify/relief/bridges.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "simplify/relief/raster.hpp"

namespace manip3d::relief_detail {
namespace {

using Point2 = std::array<double, 2>;  // column and row

/// A convex polygon of few corners.
struct Polygon {
  int size = 0;
  std::array<Point2, 7> corners{};  // those of a cell, and one more for each side of a triangle
  void add(const Point2& corner) { corners[size++] = corner; }
  [[nodiscard]] double area() const {
    double doubled = 0.0;
    for (int i = 2; i < size; ++i) {
      const Point2 &a = corners[0], &b = corners[i - 1], &c = corners[i];
      doubled += (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    }
    return 0.5 * doubled;
  }
};

/// The part of a polygon on the left of a line [Sutherland & Hodgman 1974].
Polygon left_of(const Polygon& polygon, const Corner& from, const Corner& to) {
  const auto distance = [&](const Point2& p) {
    return (to[0] - from[0]) * (p[1] - from[1]) - (to[1] - from[1]) * (p[0] - from[0]);
  };
  Polygon part;
  for (int i = 0; i < polygon.size; ++i) {
    const Point2 &a = polygon.corners[i], &b = polygon.corners[(i + 1) % polygon.size];
    const double at_a = distance(a), at_b = distance(b);
    if (at_a >= 0.0) part.add(a);
    if ((at_a >= 0.0) == (at_b >= 0.0)) continue;
    const double way = at_a / (at_a - at_b);
    part.add({a[0] + way * (b[0] - a[0]), a[1] + way * (b[1] - a[1])});
  }
  return part;
}

/// The part of the cell above and right of a pixel without a dense triangle: the whole cell, or
/// half of it.
Polygon missing_part(const Surface& surface, std::int32_t pixel) {
  const std::uint8_t cell = surface.cell(pixel);
  const double u = surface.u(pixel), v = surface.v(pixel);
  if ((cell & kFull) == 0) {
    return {4, {Point2{u, v}, Point2{u + 1, v}, Point2{u + 1, v + 1}, Point2{u, v + 1}}};
  }
  Polygon part;
  const bool is_second = (cell & kSecond) == 0;
  for (const std::int32_t p : cell_triangle(cell, is_second, pixel, surface.cols())) {
    part.add({static_cast<double>(surface.u(p)), static_cast<double>(surface.v(p))});
  }
  return part;
}

/// The share of the missing triangles of a cell that filled pixels complete.
double filled_share(const Surface& surface, std::span<const std::uint8_t> filled,
                    std::int32_t pixel) {
  const int missing = num_missing(surface.cell(pixel));
  int num_filled = 0, unmeasured = 0;
  for (const std::int32_t p :
       {pixel, pixel + 1, pixel + surface.cols(), pixel + surface.cols() + 1}) {
    num_filled += filled[p];
    unmeasured += surface.is_valid(p) || filled[p] != 0 ? 0 : 1;
  }
  // Each corner without a point takes a triangle, and the last two leave none.
  if (num_filled == 0 || unmeasured > 1) return 0.0;
  return static_cast<double>(missing - unmeasured) / missing;
}

/// A side of a triangle, for the columns at which it crosses rows.
struct Slope {
  int first = 0, last = 0;  ///< Rows.
  double start = 0.0, step = 0.0;
  Slope(const Corner& a, const Corner& b) {
    const auto& [low, high] =
        std::minmax(a, b, [](const Corner& one, const Corner& other) { return one[1] < other[1]; });
    first = low[1], last = high[1], start = low[0];
    if (last > first) step = static_cast<double>(high[0] - low[0]) / (last - first);
  }
  [[nodiscard]] double at(int row) const { return start + step * (row - first); }
};

}  // namespace

BridgedCells bridged_cells(const Surface& surface, std::span<const std::int32_t> flaws,
                           std::span<const std::uint8_t> filled, const Corners& t) {
  const std::array<Slope, 3> sides = {Slope(t[0], t[1]), Slope(t[1], t[2]), Slope(t[2], t[0])};
  const int begin = std::min({t[0][1], t[1][1], t[2][1]});
  const int end = std::max({t[0][1], t[1][1], t[2][1]});
  BridgedCells bridged;
  for (int v = begin; v < end; ++v) {
    double left = surface.cols(), right = 0.0;
    for (const Slope& side : sides) {
      if (side.first > v || side.last <= v) continue;
      left = std::min({left, side.at(v), side.at(v + 1)});
      right = std::max({right, side.at(v), side.at(v + 1)});
    }
    const std::int32_t row = v * surface.cols();
    const std::int32_t first = row + static_cast<std::int32_t>(left);
    // Rounding may exceed the last column, which has no cell.
    const std::int32_t last =
        row + std::min(static_cast<std::int32_t>(std::ceil(right)), surface.cols() - 1);
    if (flaws[first] == flaws[last]) continue;
    for (std::int32_t p = first; p < last; ++p) {
      if ((surface.cell(p) & kFull) == kFull) continue;
      Polygon part = missing_part(surface, p);
      for (int i = 0; i < 3; ++i) part = left_of(part, t[i], t[(i + 1) % 3]);
      const double area = part.area();
      bridged.all += area;
      if (!filled.empty()) bridged.filled += area * filled_share(surface, filled, p);
    }
  }
  return bridged;
}

}  // namespace manip3d::relief_detail
