#include "simplify/relief/exchange.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "simplify/relief/collapse.hpp"
#include "simplify/relief/coverage.hpp"
#include "simplify/relief/raster.hpp"
#include "simplify/relief/refine.hpp"

namespace manip3d::relief_detail {
namespace {

using Fan = Triangulation::Fan;
constexpr std::int32_t kNoVertex = Triangulation::kNone;

/// Largest distance of a new vertex from its edge, pixels.
constexpr std::int32_t kInsertionReach = 4;

/// The price of the pixels of a triangle beside its side from a to c, relative to that of a sliver.
/// Missing surface costs its area times its distance from the mesh, and pixels of a sliver count as
/// if it were two pixels wide.
float price_beside(const PixelPlace& a, const PixelPlace& b, const PixelPlace& c) {
  const auto du = static_cast<float>(c[0] - a[0]), dv = static_cast<float>(c[1] - a[1]);
  const auto height =
      static_cast<float>(std::abs(doubled_area(a, b, c))) / std::sqrt(du * du + dv * dv);
  return std::max(1.0F, 0.5F * height);
}

/// Pixels with surface in triangles and on segments, counted row by row.
class UsedPixels {
 public:
  UsedPixels(const Surface& surface, std::span<const std::int32_t> before)
      : surface_(surface), before_(before) {}
  /// In a triangle, counter-clockwise with v up, and on its sides.
  [[nodiscard]] int in(const PixelPlace& a, const PixelPlace& b, const PixelPlace& c) const {
    int count = 0;
    visit_spans(surface_.cols(), a, b, c, SidePixels::kClosed,
                [&](std::int32_t first, std::int32_t last) {
                  count += before_[last + 1] - before_[first];
                });
    return count;
  }
  /// On a segment, without its end b.
  [[nodiscard]] int on(const PixelPlace& a, const PixelPlace& b) const {
    const std::int32_t du = b[0] - a[0], dv = b[1] - a[1], steps = std::gcd(du, dv);
    int count = 0;
    for (std::int32_t i = 0; i < steps; ++i) {
      count +=
          surface_.is_used((a[1] + i * (dv / steps)) * surface_.cols() + a[0] + i * (du / steps))
              ? 1
              : 0;
    }
    return count;
  }
  /// In a triangle, without those on its side from a to c; all three corners are used.
  [[nodiscard]] int beside(const PixelPlace& a, const PixelPlace& b, const PixelPlace& c) const {
    return in(a, b, c) - on(a, c) - 1;
  }
  /// In a triangle, without those on its sides to b.
  [[nodiscard]] int behind(const PixelPlace& a, const PixelPlace& b, const PixelPlace& c) const {
    return in(a, b, c) - on(a, b) - on(b, c) - 1;
  }

 private:
  const Surface& surface_;
  std::span<const std::int32_t> before_;
};

/// Whether the dense surface ends at a pixel.
bool is_end(const Surface& surface, std::int32_t pixel) {
  const auto is_full = [&](std::int32_t cell) {
    return cell >= 0 && (surface.cell(cell) & kFull) == kFull;
  };
  const std::int32_t below = pixel - surface.cols();
  return !(is_full(pixel) && is_full(pixel - 1) && is_full(below) && is_full(below - 1));
}

/// The error of a triangle and the price of what it bridges; infinite if it lies off the surface.
/// @param pixel_price  Price of a missing pixel.
float cost_of(const Surface& surface, std::span<const std::int32_t> flaws, const Triangle& pixels,
              float pixel_price) {
  if (lies_off(surface, pixels)) return kInfinityF;
  const auto bridged = 0.5F * static_cast<float>(bridged_halves(surface, flaws, pixels));
  return triangle_error(surface, pixels) + kFalseFactor * pixel_price * bridged;
}

/// The third corner of the first triangle of a boundary vertex.
std::int32_t apex_of(const Triangulation& mesh, std::int32_t v, std::int32_t next) {
  for (const std::int32_t corner : mesh.triangle(mesh.vertex(v).triangle)) {
    if (corner != v && corner != next) return corner;
  }
  return kNoVertex;
}

/// The neighbour in a fan into which its centre may merge with the least volume between the old and
/// the new triangles, as an index; -1 if there is none.
int nearest_collapse(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                     const Fan& fan) {
  const Vec3& center = mesh.vertex(v).point;
  int best = -1;
  float least = 0.0F;
  for (int i = 0; i < fan.num_neighbors; ++i) {
    const Vec3 side = mesh.vertex(fan.neighbors[i]).point - center;
    float volume = 0.0F;
    for (int k = 0; k < fan.size; ++k) {
      const Vec3 a = mesh.vertex(fan.neighbors[k]).point - center,
                 b = mesh.vertex(fan.next(k)).point - center;
      volume += std::abs(a.cross(b).dot(side));
    }
    if (best >= 0 && !(volume < least)) continue;
    if (mesh.can_collapse(surface, v, fan, i)) best = i, least = volume;
  }
  return best;
}

}  // namespace

VertexExchange::Removal VertexExchange::removal_of(const Surface& surface,
                                                   const Triangulation& mesh, std::int32_t v,
                                                   float most) const {
  constexpr Removal kMustStay = {kInfinityF, kNoVertex};
  Fan fan;
  const Triangulation::Vertex& vertex = mesh.vertex(v);
  if (mesh.num_at(vertex.pixel) > 1 || !mesh.fan(v, fan) || fan.size < 2) return kMustStay;
  const auto pixel = [&](std::int32_t w) { return mesh.vertex(w).pixel; };
  const float price = price_of_pixel(mesh, fan, v);
  float now = 0.0F;
  for (int k = 0; k < fan.size; ++k) {
    now += cost_of(surface, flaws_, {vertex.pixel, pixel(fan.neighbors[k]), pixel(fan.next(k))},
                   price);
  }
  if (!(now < kInfinityF)) return kMustStay;
  const UsedPixels used(surface, used_before_);
  const int last = fan.num_neighbors - 1;
  float lost = 0.0F;
  if (vertex.on_boundary) {
    const PixelPlace at = place_of(mesh, v), a = place_of(mesh, fan.neighbors[0]),
                     c = place_of(mesh, fan.neighbors[last]);
    const std::int64_t turn = doubled_area(at, a, c);
    // Without the vertex the boundary runs straight from a to c. Where it bulges, surface is lost;
    // where it is dented, surface is gained.
    if (turn > 0) lost = static_cast<float>(used.beside(c, at, a)) * price_beside(c, at, a);
    if (turn < 0) lost = -static_cast<float>(used.behind(a, at, c)) * price_beside(a, at, c);
  }
  const int into = nearest_collapse(surface, mesh, v, fan);
  if (into < 0) return kMustStay;
  const std::int32_t to = fan.neighbors[into];
  float cost = lost * price - now;
  for (int k = 0; k < fan.size && cost < most; ++k) {  // a part of the cost is a lower bound
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    if (a != to && b != to)
      cost += cost_of(surface, flaws_, {pixel(to), pixel(a), pixel(b)}, price);
  }
  return {cost, cost < most ? to : kNoVertex};
}

/// The end pixel near a boundary edge that covers the most as a vertex on it, for what it bridges.
VertexExchange::Place VertexExchange::best_place(const Surface& surface, const Triangulation& mesh,
                                                 std::int32_t v, std::int32_t next,
                                                 std::int32_t apex) const {
  const PixelPlace a = place_of(mesh, v), b = place_of(mesh, next), c = place_of(mesh, apex);
  const std::int64_t du = b[0] - a[0], dv = b[1] - a[1],
                     reach2 = (du * du + dv * dv) * kInsertionReach * kInsertionReach;
  const std::int32_t left = std::max(std::min(a[0], b[0]) - kInsertionReach, 0),
                     right = std::min(std::max(a[0], b[0]) + kInsertionReach, surface.cols() - 1),
                     low = std::max(std::min(a[1], b[1]) - kInsertionReach, 0),
                     high = std::min(std::max(a[1], b[1]) + kInsertionReach, surface.rows() - 1);
  const UsedPixels used(surface, used_before_);
  Place best = {kNoVertex, 0.0F};
  float most = 0.0F;
  for (PixelPlace p = {left, low}; p[1] <= high; ++p[1]) {
    for (p[0] = left; p[0] <= right; ++p[0]) {
      const std::int64_t side = doubled_area(a, b, p);
      if (side == 0 || side * side > reach2) continue;
      const std::int32_t pixel = p[1] * surface.cols() + p[0];
      if (!surface.is_used(pixel) || mesh.num_at(pixel) > 0 || !is_end(surface, pixel)) continue;
      if (surface.is_unsure(pixel)) continue;
      if (doubled_area(a, p, c) <= 0 || doubled_area(p, b, c) <= 0) continue;
      const bool adds = side < 0;  // else the edge moves inwards
      const int pixels = adds ? used.beside(a, p, b) : -used.behind(b, p, a);
      const std::int64_t bridged =
          adds ? bridged_halves(surface, flaws_,
                                {mesh.vertex(v).pixel, pixel, mesh.vertex(next).pixel})
               : -bridged_halves(surface, flaws_,
                                 {mesh.vertex(v).pixel, mesh.vertex(next).pixel, pixel});
      const float covered = static_cast<float>(pixels) * price_beside(a, p, b);
      const float gain = covered - 0.5F * kFalseFactor * static_cast<float>(bridged);
      if (gain > most) most = gain, best = {pixel, covered};
    }
  }
  return best;
}

/// The gain of a vertex at the best place near the edge from a boundary vertex to its first
/// neighbour.
VertexExchange::Insertion VertexExchange::insertion_at(const Surface& surface,
                                                       const Triangulation& mesh,
                                                       std::int32_t v) const {
  constexpr Insertion kNothing = {0.0F, kNoVertex};
  const std::int32_t next = mesh.first_neighbor(v), apex = apex_of(mesh, v, next);
  const auto [pixel, covered] = best_place(surface, mesh, v, next, apex);
  if (pixel == kNoVertex) return kNothing;
  const std::int32_t at_a = mesh.vertex(v).pixel, at_b = mesh.vertex(next).pixel,
                     at_c = mesh.vertex(apex).pixel;
  Fan corner;
  corner.size = 1, corner.num_neighbors = 2;
  corner.neighbors[0] = next, corner.neighbors[1] = apex;
  const float price = price_of_pixel(mesh, corner, v);
  const float gain = covered * price + cost_of(surface, flaws_, {at_a, at_b, at_c}, price) -
                     cost_of(surface, flaws_, {at_a, pixel, at_c}, price) -
                     cost_of(surface, flaws_, {pixel, at_b, at_c}, price);
  return gain > 0.0F && gain < kInfinityF ? Insertion{gain, pixel} : kNothing;
}

/// Computes gains and costs of the vertices around which the mesh has changed.
void VertexExchange::evaluate(const Surface& surface, const Triangulation& mesh,
                              std::span<const Keep> keep, Ticker& ticker) {
  removals_.resize(mesh.num_slots(), {kInfinityF, kNoVertex});
  insertions_.resize(mesh.num_slots(), {0.0F, kNoVertex});
  is_stale_.resize(mesh.num_slots(), 1);
  best_.clear();
  cheapest_.clear();
  float most = 0.0F;
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (!mesh.vertex(v).alive() || !mesh.vertex(v).on_boundary) continue;
    ticker.tick();
    if (is_stale_[v] != 0) insertions_[v] = insertion_at(surface, mesh, v);
    if (insertions_[v].pixel == kNoVertex) continue;
    best_.push_back(v);
    most = std::max(most, insertions_[v].gain);
  }
  for (std::int32_t v = 0; v < mesh.num_slots() && most > 0.0F; ++v) {
    if (!mesh.vertex(v).alive()) continue;
    ticker.tick();
    const bool may_go = keep.empty() || keep[mesh.vertex(v).pixel] == Keep::kFree;
    Removal& removal = removals_[v];
    const bool is_unknown = is_stale_[v] != 0 || (removal.to == kNoVertex && removal.cost < most);
    if (may_go && is_unknown) removal = removal_of(surface, mesh, v, most);
    if (removals_[v].to != kNoVertex) cheapest_.push_back(v);
    is_stale_[v] = 0;
  }
  std::ranges::sort(best_, [&](std::int32_t a, std::int32_t b) {
    const float p = insertions_[a].gain, q = insertions_[b].gain;
    return p != q ? p > q : a < b;
  });
  std::ranges::sort(cheapest_, [&](std::int32_t a, std::int32_t b) {
    const float p = removals_[a].cost, q = removals_[b].cost;
    return p != q ? p < q : a < b;
  });
}

bool VertexExchange::may_insert(const Surface& surface, const Triangulation& mesh,
                                std::int32_t from) const {
  if (touched_[from] != 0) return false;  // it may be removed
  const std::int32_t next = mesh.first_neighbor(from);
  for (const std::int32_t v : mesh.triangle(mesh.vertex(from).triangle)) {
    if (touched_[v] != 0) return false;
  }
  // A pixel with several vertices belongs to several fans, which the new triangles could cover.
  const std::int32_t at_a = mesh.vertex(from).pixel, at_b = mesh.vertex(next).pixel,
                     pixel = insertions_[from].pixel;
  if (mesh.num_at(at_a) > 1 || mesh.num_at(at_b) > 1) return false;
  const PixelPlace a = place_of(mesh, from), b = place_of(mesh, next),
                   p = {surface.u(pixel), surface.v(pixel)};
  bool free = true;
  const bool adds = doubled_area(a, p, b) > 0;
  visit_pixels(
      surface.cols(), a, adds ? p : b, adds ? b : p, SidePixels::kClosed,
      [&](std::int32_t q) { free = free && (q == at_a || q == at_b || mesh.num_at(q) == 0); });
  if (!free || !adds) return free;
  // No vertex is in the new triangle, so that a boundary edge in it would cross both new sides.
  return !tiles_.any_near(a, p, [&](std::int32_t v) {
    if (!mesh.vertex(v).alive() || v == from) return false;
    const PixelPlace start = place_of(mesh, v), end = place_of(mesh, mesh.first_neighbor(v));
    return segments_meet(a, p, start, end) && segments_meet(p, b, start, end);
  });
}

bool VertexExchange::may_remove(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                                Fan& fan, int& into) const {
  if (touched_[v] != 0 || !mesh.fan(v, fan)) return false;
  into = -1;
  for (int i = 0; i < fan.num_neighbors; ++i) {
    if (touched_[fan.neighbors[i]] != 0) return false;
    if (fan.neighbors[i] == removals_[v].to) into = i;
  }
  return into >= 0 && mesh.can_collapse(surface, v, fan, into);
}

/// Makes the exchanges of a round, which do not touch each other.
bool VertexExchange::exchange(const Surface& surface, Triangulation& mesh, Ticker& ticker) {
  touched_.assign(mesh.num_slots(), 0);
  tiles_.collect(surface, mesh);
  bool made = false;
  Fan fan;
  int into = -1;
  auto least = cheapest_.cbegin();
  for (const std::int32_t from : best_) {
    ticker.tick();
    if (!may_insert(surface, mesh, from)) continue;
    for (const std::int32_t v : mesh.triangle(mesh.vertex(from).triangle)) touch(v);
    mesh.split_boundary(from, surface, insertions_[from].pixel);
    for (const std::int32_t v : {from, mesh.num_slots() - 1}) tiles_.add(mesh, v);
    for (auto* marks : {&touched_, &is_stale_}) marks->push_back(1);
    const auto is_worth = [&](std::int32_t v) {
      return removals_[v].cost < insertions_[from].gain;
    };
    while (least != cheapest_.cend() && is_worth(*least) &&
           !may_remove(surface, mesh, *least, fan, into)) {
      ++least;
    }
    if (least == cheapest_.cend() || !is_worth(*least)) {  // the new vertex goes again
      const std::int32_t added = mesh.num_slots() - 1;
      mesh.fan(added, fan);
      mesh.collapse(added, fan, 0);
      break;
    }
    for (int i = 0; i < fan.num_neighbors; ++i) touch(fan.neighbors[i]);
    touch(*least);
    const std::int32_t gone = *least++;
    mesh.collapse(gone, fan, into);
    if (mesh.vertex(gone).on_boundary) tiles_.add(mesh, fan.neighbors[fan.num_neighbors - 1]);
    made = true;
  }
  return made;
}

bool VertexExchange::run(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep,
                         int rounds, const Progress& progress) {
  Ticker ticker(progress);
  count_flaws(surface, flaws_);
  used_before_.resize(surface.num_pixels() + 1);
  std::int32_t count = 0;
  for (std::size_t p = 0; p < surface.num_pixels(); ++p) {
    used_before_[p] = count;
    count += surface.used()[p] != 0 ? 1 : 0;
  }
  used_before_.back() = count;
  removals_.clear();
  insertions_.clear();
  is_stale_.clear();
  bool changed = false;
  for (int round = 0; round < rounds; ++round) {
    evaluate(surface, mesh, keep, ticker);
    if (!exchange(surface, mesh, ticker)) break;
    changed = true;
  }
  mesh.compact();  // also where nothing changed: a vertex may have been added and removed again
  return changed;
}

}  // namespace manip3d::relief_detail
