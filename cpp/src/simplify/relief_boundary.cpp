#include "simplify/relief_boundary.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include "simplify/relief_collapse.hpp"
#include "simplify/relief_links.hpp"
#include "simplify/relief_raster.hpp"
#include "simplify/relief_refine.hpp"

namespace manip3d::relief_detail {
namespace {

// Price of false surface, relative to missing surface: that of collapses, except that collapses
// lower it to kChanceFalse where pixels are missing by chance, and the boundary does not.
constexpr int kFalsePixels = static_cast<int>(kFalseFactor);
constexpr int kTileShift = 4;  // tiles of 16 pixels

/// Price of the pixels of a sliver of missing surface, divided by their area times their width. A
/// sliver is up to a pixel wide and on average a third of that away from the mesh. Of 0.5, 1, 2 and
/// 4 times the price for collapses, tried on six rendered shelves, 2 leaves 0.98, 0.84 and 0.86
/// times the error at 5, 1 and 0.5 % of the points, and covers at most 0.002 less; 0.5 covers up to
/// 0.005 less.
constexpr float kSliverPrice = 2.0F * kMissingFactor / 3.0F;

bool is_between(const PixelPlace& p, const PixelPlace& a, const PixelPlace& b) {
  return p[0] >= std::min(a[0], b[0]) && p[0] <= std::max(a[0], b[0]) &&
         p[1] >= std::min(a[1], b[1]) && p[1] <= std::max(a[1], b[1]);
}

bool is_on(const PixelPlace& p, const PixelPlace& a, const PixelPlace& b) {
  return doubled_area(a, b, p) == 0 && is_between(p, a, b);
}

int sign(std::int64_t value) { return (value > 0 ? 1 : 0) - (value < 0 ? 1 : 0); }

/// Whether the bounding boxes of two segments are disjoint.
bool are_apart(const PixelPlace& a, const PixelPlace& b, const PixelPlace& p, const PixelPlace& q) {
  return std::max(a[0], b[0]) < std::min(p[0], q[0]) ||
         std::max(p[0], q[0]) < std::min(a[0], b[0]) ||
         std::max(a[1], b[1]) < std::min(p[1], q[1]) || std::max(p[1], q[1]) < std::min(a[1], b[1]);
}

/// Whether two segments have a common point.
bool meet(const PixelPlace& a, const PixelPlace& b, const PixelPlace& p, const PixelPlace& q) {
  const int sp = sign(doubled_area(a, b, p)), sq = sign(doubled_area(a, b, q));
  const int sa = sign(doubled_area(p, q, a)), sb = sign(doubled_area(p, q, b));
  if (sp * sq < 0 && sa * sb < 0) return true;
  return (sp == 0 && is_between(p, a, b)) || (sq == 0 && is_between(q, a, b)) ||
         (sa == 0 && is_between(a, p, q)) || (sb == 0 && is_between(b, p, q));
}

/// Change of the covered surface, in pixels, when a boundary vertex moves by a pixel, at one of its
/// two boundary edges. `end` is the other end of the edge; the mesh lies to the left of the edge,
/// which starts at the vertex if `starts` is true. A covered pixel without surface counts
/// -kFalsePixels.
int worth(const Surface& surface, const PixelPlace& from, const PixelStep& step,
          const PixelPlace& end, bool starts) {
  const std::int32_t turn = (end[0] - from[0]) * step.dv - (end[1] - from[1]) * step.du;
  if (turn == 0) return 0;
  // When the mesh gains pixels, those of the old edge are covered already; when it loses some,
  // those of the new edge stay covered. Neither are counted.
  int sum = 0;
  if ((turn < 0) == starts) {
    visit_sliver(
        surface.cols(), from, {step.du, step.dv}, end, [&](std::int32_t pixel, bool is_old, bool) {
          if (is_old) return;
          sum += surface.is_used(pixel) && step.is_linked(surface, pixel) ? 1 : -kFalsePixels;
        });
  } else {
    visit_sliver(surface.cols(), from, {step.du, step.dv}, end,
                 [&](std::int32_t pixel, bool, bool is_new) {
                   if (!is_new) sum -= surface.is_used(pixel) ? 1 : -kFalsePixels;
                 });
  }
  return sum;
}

/// The outer sides of a fan relative to its centre; they show which moves of the centre flip a
/// triangle.
class FanSides {
 public:
  FanSides(const Triangulation& mesh, const Triangulation::Fan& fan, const PixelPlace& center)
      : size_(fan.size) {
    for (int i = 0; i < fan.size; ++i) {
      const PixelPlace a = place_of(mesh, fan.neighbors[i]), b = place_of(mesh, fan.next(i));
      const std::int32_t du = b[0] - a[0], dv = b[1] - a[1];
      sides_[i] = {du, dv, du * (center[1] - a[1]) - dv * (center[0] - a[0])};
    }
  }
  /// Whether all triangles keep a positive area if the centre moves by this step.
  [[nodiscard]] bool stay(int du, int dv) const {
    for (int i = 0; i < size_; ++i) {
      const Side& side = sides_[i];
      if (side.doubled_area + side.du * dv - side.dv * du <= 0) return false;
    }
    return true;
  }

 private:
  struct Side {
    std::int32_t du, dv, doubled_area;
  };
  int size_;
  std::array<Side, Triangulation::kMaxFan> sides_;  // the first size_ ones
};

}  // namespace

float price_of_pixel(const Triangulation& mesh, const Triangulation::Fan& fan, std::int32_t v) {
  float area = 0.0F;  // sum of the areas, times two
  std::int64_t pixels = 0;
  const Triangulation::Vertex& center = mesh.vertex(v);
  for (int i = 0; i < fan.size; ++i) {
    const std::int32_t a = fan.neighbors[i], b = fan.next(i);
    area += (mesh.vertex(a).point - center.point).cross(mesh.vertex(b).point - center.point).norm();
    pixels += mesh.orient(v, a, b);
  }
  const float pixel_area = area / static_cast<float>(pixels);
  return kSliverPrice * pixel_area * std::sqrt(pixel_area);
}

bool segments_meet(const PixelPlace& a, const PixelPlace& b, const PixelPlace& p,
                   const PixelPlace& q) {
  return !are_apart(a, b, p, q) && meet(a, b, p, q);
}

BoundaryTiles::Box BoundaryTiles::box_of(const PixelPlace& a, const PixelPlace& b) const {
  const auto [left, right] = std::minmax(a[0], b[0]);
  const auto [low, high] = std::minmax(a[1], b[1]);
  return {std::max(left - 1, 0) >> kTileShift, std::max(low - 1, 0) >> kTileShift,
          std::min((right + 1) >> kTileShift, across_ - 1),
          std::min((high + 1) >> kTileShift, down_ - 1)};
}

void BoundaryTiles::add(const Triangulation& mesh, std::int32_t from) {
  const Box box = box_of(place_of(mesh, from), place_of(mesh, mesh.first_neighbor(from)));
  for (int v = box.v0; v <= box.v1; ++v) {
    for (int u = box.u0; u <= box.u1; ++u) {
      std::int32_t& newest = newest_in_[v * across_ + u];
      entries_.push_back({from, newest});
      newest = static_cast<std::int32_t>(entries_.size()) - 1;
    }
  }
}

void BoundaryTiles::collect(const Surface& surface, const Triangulation& mesh) {
  across_ = (surface.cols() >> kTileShift) + 1;
  down_ = (surface.rows() >> kTileShift) + 1;
  newest_in_.assign(static_cast<std::size_t>(across_) * down_, -1);
  entries_.clear();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (mesh.vertex(v).alive() && mesh.vertex(v).on_boundary) add(mesh, v);
  }
}

bool BoundaryMover::meets_other(const Triangulation& mesh, std::int32_t v, std::int32_t first,
                                std::int32_t last, const Pixel& to) const {
  for (const std::int32_t end : {first, last}) {
    const Pixel a = place_of(mesh, end);
    const auto meets = [&](std::int32_t p) {
      const std::int32_t q = mesh.first_neighbor(p);
      if (p == v || q == v) return false;
      const Pixel at_p = place_of(mesh, p), at_q = place_of(mesh, q);
      if (are_apart(a, to, at_p, at_q)) return false;
      // The other side of a hole of three vertices.
      if ((p == first && q == last) || (p == last && q == first)) {
        return sign(doubled_area(at_p, at_q, to)) !=
               sign(doubled_area(at_p, at_q, place_of(mesh, v)));
      }
      // They start at the same vertex; neither may lie on the other.
      if (p == end || q == end) {
        return is_on(p == end ? at_q : at_p, a, to) || is_on(to, at_p, at_q);
      }
      return meet(a, to, at_p, at_q);
    };
    if (tiles_.any_near(a, to, meets)) return true;
  }
  return false;
}

bool BoundaryMover::move(const Surface& surface, Triangulation& mesh, bool at_any_price,
                         std::int32_t v) {
  Triangulation::Fan fan;
  if (!mesh.fan(v, fan)) return false;
  const std::int32_t first = fan.neighbors[0], last = fan.neighbors[fan.num_neighbors - 1];
  // A pixel with several vertices belongs to several fans; a move could cover the others unnoticed.
  for (const std::int32_t at : {v, first, last}) {
    if (mesh.num_at(mesh.vertex(at).pixel) > 1) return false;
  }
  const std::int32_t cols = surface.cols();
  const Pixel from = place_of(mesh, v), to_first = place_of(mesh, first),
              to_last = place_of(mesh, last);
  const FanSides sides(mesh, fan, from);
  const std::int32_t at_v = mesh.vertex(v).pixel, at_first = mesh.vertex(first).pixel,
                     at_last = mesh.vertex(last).pixel;
  const auto is_free = [&](const PixelStep& step, const Pixel& end) {
    if ((end[0] - from[0]) * step.dv == (end[1] - from[1]) * step.du) return true;
    bool free = true;
    visit_sliver(cols, from, {step.du, step.dv}, end, [&](std::int32_t p, bool, bool) {
      free = free && (mesh.num_at(p) == 0 || p == at_v || p == at_first || p == at_last);
    });
    return free;
  };
  std::array<float, Triangulation::kMaxFan> errors{};
  const auto error_at = [&](std::int32_t pixel) {
    return Refiner::error_at(surface, mesh, fan, pixel, kInfinityF, errors);
  };
  float error = -1.0F;  // unknown
  const auto is_worth = [&](std::int32_t pixel, int pixels) {
    if (at_any_price) return true;
    if (error < 0.0F) error = error_at(at_v);
    return error_at(pixel) - error < static_cast<float>(pixels) * price_of_pixel(mesh, fan, v);
  };
  // The gain of each step. Whether a step is possible is tested only for the best ones.
  std::array<int, 9> worths{};
  for (int i = 0; i < 9; ++i) {
    const PixelStep step(i % 3 - 1, i / 3 - 1, cols);
    const Pixel to = {from[0] + step.du, from[1] + step.dv};
    if (to[0] < 0 || to[1] < 0 || to[0] >= cols || to[1] >= surface.rows()) continue;
    const std::int32_t pixel = at_v + step.dv * cols + step.du;
    if (pixel == at_v || !surface.is_used(pixel) || mesh.num_at(pixel) > 0) continue;
    if (!step.is_linked(surface, pixel) || !sides.stay(step.du, step.dv)) continue;
    worths[i] =
        worth(surface, from, step, to_first, true) + worth(surface, from, step, to_last, false);
  }
  is_settled_[v] = *std::max_element(worths.begin(), worths.end()) <= 0 ? 1 : 0;
  for (;;) {
    const auto best = std::max_element(worths.begin(), worths.end());  // the first of equal ones
    if (*best <= 0) return false;
    const int pixels = std::exchange(*best, 0);
    const auto i = static_cast<int>(best - worths.begin());
    const PixelStep step(i % 3 - 1, i / 3 - 1, cols);
    const Pixel to = {from[0] + step.du, from[1] + step.dv};
    const std::int32_t pixel = at_v + step.dv * cols + step.du;
    if (!is_free(step, to_first) || !is_free(step, to_last)) continue;
    if (meets_other(mesh, v, first, last, to) || !is_worth(pixel, pixels)) continue;
    mesh.move(v, surface, pixel);
    is_settled_[v] = 0;
    for (int k = 0; k < fan.num_neighbors; ++k) is_settled_[fan.neighbors[k]] = 0;
    return true;
  }
}

void BoundaryMover::run(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep,
                        int sweeps, bool at_any_price, const Progress& progress) {
  Ticker ticker(progress);
  make_room(is_settled_, mesh.num_slots());
  is_settled_.assign(mesh.num_slots(), 0);
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    tiles_.collect(surface, mesh);
    bool moved = false;
    for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
      if (!mesh.vertex(v).alive() || !mesh.vertex(v).on_boundary) continue;
      ticker.tick();
      if (is_settled_[v] != 0) continue;
      if (!keep.empty() && keep[mesh.vertex(v).pixel] != Keep::kFree) continue;
      moved = move(surface, mesh, at_any_price, v) || moved;
    }
    if (!moved) return;
  }
}

}  // namespace manip3d::relief_detail
