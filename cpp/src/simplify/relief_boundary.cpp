#include "simplify/relief_boundary.hpp"

#include <algorithm>

#include "simplify/relief_raster.hpp"

namespace manip3d::relief_detail {
namespace {

using PixelPlace = std::array<std::int32_t, 2>;

// A false surface costs ten times as much as a missing one, as where edges collapse.
constexpr int kFalseFactor = 10;
constexpr int kTileShift = 4;  // tiles of 16 pixels

std::int64_t doubled_area(const PixelPlace& a, const PixelPlace& b, const PixelPlace& c) {
  return std::int64_t{b[0] - a[0]} * (c[1] - a[1]) - std::int64_t{b[1] - a[1]} * (c[0] - a[0]);
}

PixelPlace place_of(const Triangulation& mesh, std::int32_t v) {
  return {mesh.vertex(v).u, mesh.vertex(v).v};
}

bool is_between(const PixelPlace& p, const PixelPlace& a, const PixelPlace& b) {
  return p[0] >= std::min(a[0], b[0]) && p[0] <= std::max(a[0], b[0]) &&
         p[1] >= std::min(a[1], b[1]) && p[1] <= std::max(a[1], b[1]);
}

/// As ==, which would compare bytes by a call.
bool is_same(const PixelPlace& p, const PixelPlace& q) { return p[0] == q[0] && p[1] == q[1]; }

bool is_on(const PixelPlace& p, const PixelPlace& a, const PixelPlace& b) {
  return doubled_area(a, b, p) == 0 && is_between(p, a, b);
}

int sign(std::int64_t value) { return (value > 0 ? 1 : 0) - (value < 0 ? 1 : 0); }

/// Do two segments have a point in common?
bool meet(const PixelPlace& a, const PixelPlace& b, const PixelPlace& p, const PixelPlace& q) {
  const int sp = sign(doubled_area(a, b, p)), sq = sign(doubled_area(a, b, q));
  const int sa = sign(doubled_area(p, q, a)), sb = sign(doubled_area(p, q, b));
  if (sp * sq < 0 && sa * sb < 0) return true;
  return (sp == 0 && is_between(p, a, b)) || (sq == 0 && is_between(q, a, b)) ||
         (sa == 0 && is_between(a, p, q)) || (sb == 0 && is_between(b, p, q));
}

/// Is there a dense edge between two neighbouring pixels, or a whole cell if they are diagonal?
bool is_linked(const Surface& surface, PixelPlace p, PixelPlace q) {
  if (p[1] > q[1] || (p[1] == q[1] && p[0] > q[0])) std::swap(p, q);
  const int cols = surface.cols();
  const auto cell = [&](int u, int v) -> unsigned {
    return u >= 0 && v >= 0 ? surface.cell(v * cols + u) : 0U;
  };
  if (p[1] == q[1]) {
    return (cell(p[0], p[1]) & kFirst) != 0 || (cell(p[0], p[1] - 1) & kSecond) != 0;
  }
  if (p[0] == q[0]) {
    const auto has_side = [](unsigned one, bool left) {  // ac or bd
      const bool turned = (one & kCutFromBToC) != 0;
      return (one & (turned == left ? kFirst : kSecond)) != 0;
    };
    return has_side(cell(p[0], p[1]), true) || has_side(cell(p[0] - 1, p[1]), false);
  }
  return (cell(std::min(p[0], q[0]), p[1]) & kFull) == kFull;
}

/// Calls visit(pixel, place) for the pixels in and on a triangle: one division for each row.
template <typename Visit>
void visit_places(int cols, const std::array<PixelPlace, 3>& t, Visit&& visit) {
  visit_spans(cols, t[0], t[1], t[2], SidePixels::kClosed,
              [&](std::int32_t first, std::int32_t last) {
                const std::int32_t v = first / cols, u = first - v * cols;
                for (std::int32_t p = first; p <= last; ++p) visit(p, PixelPlace{u + p - first, v});
              });
}

/// Change of the covered surface, in pixels, when a boundary vertex moves by a pixel, seen at one
/// of its two boundary edges: `from` and `to` are its places, `end` is the edge's other end, and
/// the mesh lies on the left of the edge, which begins at the vertex where `starts` is true. A
/// covered pixel without surface counts -kFalseFactor.
int worth(const Surface& surface, const PixelPlace& from, const PixelPlace& to,
          const PixelPlace& end, bool starts) {
  const std::int64_t turn = starts ? doubled_area(from, end, to) : doubled_area(end, from, to);
  if (turn == 0) return 0;
  const bool gains = turn < 0;
  // Pixels of the old edge are covered already when pixels are won, those of the new edge stay
  // covered when pixels are lost: neither counts.
  const PixelPlace& kept = gains ? from : to;
  std::array<PixelPlace, 3> t = {from, end, to};
  if (doubled_area(t[0], t[1], t[2]) < 0) std::swap(t[1], t[2]);
  int sum = 0;
  visit_places(surface.cols(), t, [&](std::int32_t pixel, const PixelPlace& p) {
    if (is_on(p, kept, end)) return;
    const PixelPlace back = {p[0] - (to[0] - from[0]), p[1] - (to[1] - from[1])};
    const bool is_surface = surface.is_used(pixel) && (!gains || is_linked(surface, p, back));
    sum += is_surface ? 1 : -kFalseFactor;
  });
  return gains ? sum : -sum;
}

}  // namespace

void BoundaryMover::collect_edges(const Surface& surface, const Triangulation& mesh) {
  tiles_across_ = (surface.cols() >> kTileShift) + 1;
  tiles_down_ = (surface.rows() >> kTileShift) + 1;
  edges_.clear();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (!mesh.vertex(v).alive() || !mesh.vertex(v).on_boundary) continue;
    edges_.push_back({v, mesh.first_neighbor(v)});
  }
  const auto tiles_of = [&](const Edge& edge, auto&& visit) {
    const PixelPlace a = place_of(mesh, edge.from);
    visit_tiles({a, place_of(mesh, edge.to), a}, visit);
  };
  first_in_.assign(static_cast<std::size_t>(tiles_across_) * tiles_down_ + 1, 0);
  for (const Edge& edge : edges_) tiles_of(edge, [&](std::int32_t tile) { ++first_in_[tile]; });
  std::int32_t total = 0;
  for (std::int32_t& first : first_in_) first = total += first;
  make_room(in_tile_, total);
  in_tile_.resize(total);
  for (std::size_t i = 0; i < edges_.size(); ++i) {
    tiles_of(edges_[i], [&](std::int32_t tile) {
      in_tile_[--first_in_[tile]] = static_cast<std::int32_t>(i);
    });
  }
}

/// The tiles of a box around three pixels that may each move by one.
template <typename Visit>
void BoundaryMover::visit_tiles(const std::array<Pixel, 3>& corners, Visit&& visit) const {
  const auto [left, right] = std::minmax({corners[0][0], corners[1][0], corners[2][0]});
  const auto [low, high] = std::minmax({corners[0][1], corners[1][1], corners[2][1]});
  const int u0 = std::max(left - 1, 0) >> kTileShift, v0 = std::max(low - 1, 0) >> kTileShift;
  const int u1 = std::min((right + 1) >> kTileShift, tiles_across_ - 1);
  const int v1 = std::min((high + 1) >> kTileShift, tiles_down_ - 1);
  for (int v = v0; v <= v1; ++v) {
    for (int u = u0; u <= u1; ++u) visit(v * tiles_across_ + u);
  }
}

bool BoundaryMover::keeps_fan(const Triangulation& mesh, const Triangulation::Fan& fan,
                              const Pixel& to) const {
  for (int i = 0; i < fan.size; ++i) {
    if (doubled_area(to, place_of(mesh, fan.neighbors[i]), place_of(mesh, fan.next(i))) <= 0) {
      return false;
    }
  }
  return true;
}

bool BoundaryMover::meets_other(const Triangulation& mesh, std::int32_t v, std::int32_t first,
                                std::int32_t last, const Pixel& to) const {
  bool met = false;
  for (const std::int32_t end : {first, last}) {
    const Pixel a = place_of(mesh, end);
    visit_tiles({a, to, a}, [&](std::int32_t tile) {
      for (std::int32_t k = first_in_[tile]; k < first_in_[tile + 1] && !met; ++k) {
        const auto [p, q] = edges_[in_tile_[k]];
        if (p == v || q == v) continue;
        const Pixel at_p = place_of(mesh, p), at_q = place_of(mesh, q);
        if ((p == first && q == last) || (p == last && q == first)) {  // around a hole of three
          met = sign(doubled_area(at_p, at_q, to)) !=
                sign(doubled_area(at_p, at_q, place_of(mesh, v)));
        } else if (p == end || q == end) {  // they start together: neither may lie on the other
          met = is_on(p == end ? at_q : at_p, a, to) || is_on(to, at_p, at_q);
        } else {
          met = meet(a, to, at_p, at_q);
        }
      }
    });
  }
  return met;
}

bool BoundaryMover::move(const Surface& surface, Triangulation& mesh, std::int32_t v) {
  Triangulation::Fan fan;
  if (!mesh.fan(v, fan)) return false;
  const std::int32_t first = fan.neighbors[0], last = fan.neighbors[fan.num_neighbors - 1];
  // A pixel with several vertices joins several fans; a move could cover the others unnoticed.
  for (const std::int32_t at : {v, first, last}) {
    if (mesh.num_at(mesh.vertex(at).pixel) > 1) return false;
  }
  const Pixel from = place_of(mesh, v), to_first = place_of(mesh, first),
              to_last = place_of(mesh, last);
  const auto is_free = [&](const Pixel& to, const Pixel& end) {
    std::array<Pixel, 3> t = {from, end, to};
    const std::int64_t turn = doubled_area(t[0], t[1], t[2]);
    if (turn < 0) std::swap(t[1], t[2]);
    bool free = true;
    if (turn != 0) {
      visit_places(surface.cols(), t, [&](std::int32_t p, const Pixel& at) {
        free = free && (mesh.num_at(p) == 0 || is_same(at, from) || is_same(at, to_first) ||
                        is_same(at, to_last));
      });
    }
    return free;
  };
  int most = 0;
  Pixel best{};
  for (int dv = -1; dv <= 1; ++dv) {
    for (int du = -1; du <= 1; ++du) {
      const Pixel to = {from[0] + du, from[1] + dv};
      if (to[0] < 0 || to[1] < 0 || to[0] >= surface.cols() || to[1] >= surface.rows()) continue;
      const std::int32_t pixel = to[1] * surface.cols() + to[0];
      if (is_same(to, from) || !surface.is_used(pixel) || mesh.num_at(pixel) > 0) continue;
      if (!is_linked(surface, from, to) || !keeps_fan(mesh, fan, to)) continue;
      const int value =
          worth(surface, from, to, to_first, true) + worth(surface, from, to, to_last, false);
      if (value <= most || !is_free(to, to_first) || !is_free(to, to_last)) continue;
      if (meets_other(mesh, v, first, last, to)) continue;
      most = value;
      best = to;
    }
  }
  if (most == 0) return false;
  mesh.move(v, surface, best[1] * surface.cols() + best[0]);
  return true;
}

void BoundaryMover::run(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep,
                        int sweeps) {
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    collect_edges(surface, mesh);
    bool moved = false;
    for (const Edge& edge : edges_) {
      if (!keep.empty() && keep[mesh.vertex(edge.from).pixel] != Keep::kFree) continue;
      moved = move(surface, mesh, edge.from) || moved;
    }
    if (!moved) return;
  }
}

}  // namespace manip3d::relief_detail
