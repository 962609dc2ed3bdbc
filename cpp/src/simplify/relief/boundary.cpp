#include "simplify/relief/boundary.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <utility>

#include "simplify/relief/collapse.hpp"
#include "simplify/relief/links.hpp"
#include "simplify/relief/raster.hpp"
#include "simplify/relief/refine.hpp"

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

/// A boundary vertex with its fan, and its steps to the pixels around it.
class BoundaryMover::Vertex {
 public:
  using Gains = std::array<int, 9>;  ///< By step.

  Vertex(const Surface& surface, const Triangulation& mesh, std::int32_t v,
         const Triangulation::Fan& fan)
      : surface_(surface),
        mesh_(mesh),
        fan_(fan),
        v_(v),
        first_(fan.neighbors[0]),
        last_(fan.neighbors[fan.num_neighbors - 1]),
        place_(place_of(mesh, v)) {}

  [[nodiscard]] const Triangulation& mesh() const { return mesh_; }
  [[nodiscard]] std::int32_t number() const { return v_; }
  /// The other ends of the two boundary edges.
  [[nodiscard]] std::int32_t first() const { return first_; }
  [[nodiscard]] std::int32_t last() const { return last_; }
  [[nodiscard]] std::int32_t pixel() const { return mesh_.vertex(v_).pixel; }

  [[nodiscard]] PixelStep step(int i) const { return {i % 3 - 1, i / 3 - 1, surface_.cols()}; }
  [[nodiscard]] PixelPlace place_after(const PixelStep& step) const {
    return {place_[0] + step.du, place_[1] + step.dv};
  }
  [[nodiscard]] std::int32_t pixel_after(const PixelStep& step) const {
    return pixel() + step.dv * surface_.cols() + step.du;
  }

  /// Whether a pixel of the boundary edges has several vertices. They belong to several fans, and a
  /// move could cover the others unnoticed.
  [[nodiscard]] bool shares_pixel() const {
    return std::ranges::any_of(std::array{v_, first_, last_}, [this](std::int32_t v) {
      return mesh_.num_at(mesh_.vertex(v).pixel) > 1;
    });
  }

  /// The number of pixels that the mesh gains by each step; 0 for a step that leaves the surface or
  /// flips a triangle. is_free() and meets_other(), which take longer, are left to the best steps.
  [[nodiscard]] Gains gains() const {
    const FanSides sides(mesh_, fan_, place_);
    const PixelPlace to_first = place_of(mesh_, first_), to_last = place_of(mesh_, last_);
    Gains gains{};
    for (int i = 0; i < static_cast<int>(gains.size()); ++i) {
      const PixelStep by = step(i);
      const auto [u, v] = place_after(by);
      if (u < 0 || v < 0 || u >= surface_.cols() || v >= surface_.rows()) continue;
      const std::int32_t to = pixel_after(by);
      if (to == pixel() || !surface_.is_used(to) || mesh_.num_at(to) > 0) continue;
      if (!by.is_linked(surface_, to) || !sides.stay(by.du, by.dv)) continue;
      gains[i] =
          worth(surface_, place_, by, to_first, true) + worth(surface_, place_, by, to_last, false);
    }
    return gains;
  }

  /// Whether a step covers no other vertex.
  [[nodiscard]] bool is_free(const PixelStep& step) const {
    return is_free_beside(step, first_) && is_free_beside(step, last_);
  }

  /// The error around the vertex if it were at a pixel.
  [[nodiscard]] float error_at(std::int32_t pixel) const {
    std::array<float, Triangulation::kMaxFan> errors{};
    return Refiner::error_at(surface_, mesh_, fan_, pixel, kInfinityF, errors);
  }
  /// The growth of the error at which a gain of pixels is not worth it.
  [[nodiscard]] float price_of(int pixels) const {
    return static_cast<float>(pixels) * price_of_pixel(mesh_, fan_, v_);
  }

 private:
  [[nodiscard]] bool is_free_beside(const PixelStep& step, std::int32_t neighbor) const {
    const PixelPlace end = place_of(mesh_, neighbor);
    if ((end[0] - place_[0]) * step.dv == (end[1] - place_[1]) * step.du) return true;
    const std::array own = {pixel(), mesh_.vertex(first_).pixel, mesh_.vertex(last_).pixel};
    bool free = true;
    visit_sliver(surface_.cols(), place_, {step.du, step.dv}, end, [&](std::int32_t p, bool, bool) {
      free = free && (mesh_.num_at(p) == 0 || std::ranges::find(own, p) != own.end());
    });
    return free;
  }

  const Surface& surface_;
  const Triangulation& mesh_;
  const Triangulation::Fan& fan_;
  std::int32_t v_, first_, last_;
  PixelPlace place_;
};

bool BoundaryMover::meets_other(const Vertex& vertex, const PixelPlace& to) const {
  const Triangulation& mesh = vertex.mesh();
  const std::int32_t v = vertex.number(), first = vertex.first(), last = vertex.last();
  for (const std::int32_t end : {first, last}) {
    const PixelPlace a = place_of(mesh, end);
    const auto meets = [&](std::int32_t p) {
      const std::int32_t q = mesh.first_neighbor(p);
      if (p == v || q == v) return false;
      const PixelPlace at_p = place_of(mesh, p), at_q = place_of(mesh, q);
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

std::int32_t BoundaryMover::first_legal(const Vertex& vertex, std::array<int, 9> gains,
                                        bool at_any_price) const {
  std::optional<float> error;  // at the pixel of the vertex; computed when a step is compared
  for (;;) {
    const auto best = std::max_element(gains.begin(), gains.end());  // the first of equal ones
    if (*best <= 0) return -1;
    const int gain = std::exchange(*best, 0);
    const PixelStep step = vertex.step(static_cast<int>(best - gains.begin()));
    if (!vertex.is_free(step) || meets_other(vertex, vertex.place_after(step))) continue;
    const std::int32_t pixel = vertex.pixel_after(step);
    if (at_any_price) return pixel;
    if (!error) error = vertex.error_at(vertex.pixel());
    if (vertex.error_at(pixel) - *error < vertex.price_of(gain)) return pixel;
  }
}

bool BoundaryMover::move(const Surface& surface, Triangulation& mesh, bool at_any_price,
                         std::int32_t v) {
  Triangulation::Fan fan;
  if (!mesh.fan(v, fan)) return false;
  const Vertex vertex(surface, mesh, v, fan);
  if (vertex.shares_pixel()) return false;
  const Vertex::Gains gains = vertex.gains();
  is_settled_[v] = *std::max_element(gains.begin(), gains.end()) <= 0 ? 1 : 0;
  const std::int32_t pixel = first_legal(vertex, gains, at_any_price);
  if (pixel < 0) return false;
  mesh.move(v, surface, pixel);
  is_settled_[v] = 0;
  for (int k = 0; k < fan.num_neighbors; ++k) is_settled_[fan.neighbors[k]] = 0;
  return true;
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
