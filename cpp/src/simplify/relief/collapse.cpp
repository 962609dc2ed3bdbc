#include "simplify/relief/collapse.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "simplify/relief/coverage.hpp"
#include "simplify/relief/few.hpp"
#include "simplify/relief/raster.hpp"

namespace manip3d::relief_detail {
namespace {

// Pixels without confidence are surface as well: losing them counts at least this share of losing
// surface of mean confidence.
constexpr float kMinLoss = 0.05F;
// The share of the price of covering a place without surface between three pixels without
// confidence. Noise makes holes and steps there, which must not hold vertices.
constexpr float kUnsureCover = 0.001F;
constexpr std::int32_t kNoRound = -2;
constexpr float kStays = std::numeric_limits<float>::infinity();

using Fan = Triangulation::Fan;
constexpr std::int32_t kNone = Triangulation::kNone;

/// The price of losing a triangle, by its distance from the side ac: the lower bound of the price
/// of a cut. Quadrics underestimate it, because each end of a side has only a part of its length.
float price_of_cut(float boundary_weight, const Vec3& a, const Vec3& b, const Vec3& c) {
  const float doubled_area = (b - a).cross(c - a).norm();
  const float side = (c - a).norm();
  return side > 0.0F ? boundary_weight * doubled_area * doubled_area / side : 0.0F;
}

/// Confidence of a triangle's plane: the smaller of the least confidence of its corners and the
/// mean confidence of the other pixels in it.
float confidence_of(const Surface& surface, const Triangulation& mesh, const Triangle& corners) {
  if (!surface.has_confidence()) return 1.0F;
  const auto &a = mesh.vertex(corners[0]), &b = mesh.vertex(corners[1]),
             &c = mesh.vertex(corners[2]);
  const auto [first_u, last_u] = std::minmax({a.u, b.u, c.u});
  const auto [first_v, last_v] = std::minmax({a.v, b.v, c.v});
  if (surface.has_full_confidence(first_u, first_v, last_u, last_v)) return 1.0F;
  float sum = 0.0F;
  int count = 0;
  visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, SidePixels::kClosed,
               [&](std::int32_t p) {
                 if (p == a.pixel || p == b.pixel || p == c.pixel) return;
                 sum += surface.confidence(p);
                 ++count;
               });
  const float mean = count > 0 ? sum / static_cast<float>(count) : 1.0F;
  return std::min({mean, surface.confidence(a.pixel), surface.confidence(b.pixel),
                   surface.confidence(c.pixel)});
}

/// Does no corner of a triangle have confidence?
bool is_unsure(const Surface& surface, const Triangulation& mesh, const Triangle& corners) {
  return std::ranges::all_of(
      corners, [&](std::int32_t v) { return surface.is_unsure(mesh.vertex(v).pixel); });
}

/// The share at which covering a place without surface between three vertices counts.
float share_of_cover(const Surface& surface, const Triangulation& mesh, const Triangle& corners) {
  return is_unsure(surface, mesh, corners) ? kUnsureCover : 1.0F;
}

Triangle pixels_of(const Triangulation& mesh, const Triangle& t) {
  return {mesh.vertex(t[0]).pixel, mesh.vertex(t[1]).pixel, mesh.vertex(t[2]).pixel};
}

bool face_lies_off(const Surface& surface, const Triangulation& mesh, const Triangle& t) {
  return lies_off(surface, pixels_of(mesh, t));
}

/// The sum over the pixels in a triangle of their weight times their distance from its plane.
float error_over(const Surface& surface, const Triangulation& mesh, std::int32_t p, std::int32_t q,
                 std::int32_t r) {
  const Triangulation::Vertex &a = mesh.vertex(p), &b = mesh.vertex(q), &c = mesh.vertex(r);
  const Vec3 n = (b.point - a.point).cross(c.point - a.point).normalized();
  float sum = 0.0F;
  visit_pixels(surface.cols(), {a.u, a.v}, {b.u, b.v}, {c.u, c.v}, SidePixels::kShared,
               [&](std::int32_t pixel) {
                 const Sample& s = surface.sample(pixel);
                 if (s.weight > 0.0F) sum += s.weight * std::abs(n.dot(s.point() - a.point));
               });
  return sum;
}

/// Does a fan hold pixels without confidence as well as others?
bool is_at_rim(const Surface& surface, const Triangulation& mesh, std::int32_t v, const Fan& fan) {
  if (!surface.avoids_unsure()) return false;
  const Triangulation::Vertex& center = mesh.vertex(v);
  int first_u = center.u, last_u = first_u, first_v = center.v, last_v = first_v;
  for (int i = 0; i < fan.num_neighbors; ++i) {
    const Triangulation::Vertex& other = mesh.vertex(fan.neighbors[i]);
    first_u = std::min(first_u, other.u), last_u = std::max(last_u, other.u);
    first_v = std::min(first_v, other.v), last_v = std::max(last_v, other.v);
  }
  if (surface.has_full_confidence(first_u, first_v, last_u, last_v)) return false;
  bool has_unsure = false, has_sure = false;
  for (int i = 0; i < fan.size && !(has_unsure && has_sure); ++i) {
    const Triangulation::Vertex &a = mesh.vertex(fan.neighbors[i]), &b = mesh.vertex(fan.next(i));
    visit_pixels(
        surface.cols(), {center.u, center.v}, {a.u, a.v}, {b.u, b.v}, SidePixels::kClosed,
        [&](std::int32_t pixel) { (surface.is_unsure(pixel) ? has_unsure : has_sure) = true; });
  }
  return has_unsure && has_sure;
}

/// Adds like LocalQuadric::add_plane_through_origin(), four numbers at a time.
class QuadricSum {
 public:
  QuadricSum(const Vec3& n, float weight) {
    const Vec3 wn = weight * n;
    first_ = Float4{wn.x(), wn.x(), wn.x(), wn.y()} * Float4{n.x(), n.y(), n.z(), n.y()};
    second_ = Float4{wn.y(), wn.z(), 0.0F, 0.0F} * n.z();
    third_ = Float4{0.0F, 0.0F, weight, 0.0F};
  }
  /// @param to  The first number of a quadric; 0 is added to the number after its last one.
  void add_to(float* to) const {
    static_assert(offsetof(LocalQuadric, yz) == 4 * sizeof(float) &&
                  offsetof(LocalQuadric, bz) == 8 * sizeof(float) &&
                  offsetof(LocalQuadric, weight) == 10 * sizeof(float));
    store4(to, load4(to) + first_);
    store4(to + 4, load4(to + 4) + second_);
    store4(to + 8, load4(to + 8) + third_);
  }

 private:
  Float4 first_, second_, third_;
};

}  // namespace

void LocalQuadric::add(const LocalQuadric& q, const Vec3& offset) {
  // Q(p - offset) expanded around this vertex.
  const Vec3 d = -offset;
  const Vec3 ad(q.xx * d.x() + q.xy * d.y() + q.xz * d.z(),
                q.xy * d.x() + q.yy * d.y() + q.yz * d.z(),
                q.xz * d.x() + q.yz * d.y() + q.zz * d.z());
  c += std::max(0.0F, q.c + d.dot(ad) + 2.0F * (q.bx * d.x() + q.by * d.y() + q.bz * d.z()));
  xx += q.xx, xy += q.xy, xz += q.xz, yy += q.yy, yz += q.yz, zz += q.zz;
  bx += q.bx + ad.x(), by += q.by + ad.y(), bz += q.bz + ad.z();
  weight += q.weight;
}

void Collapser::assign(const Surface& surface, const Triangulation& mesh,
                       std::span<const Keep> keep, float keep_factor, float missing_factor,
                       float false_factor) {
  // A cut along a side of length L at distance d loses the area L d / 2, at the mean distance d /
  // 3.
  boundary_weight_ = missing_factor / 6.0F;
  cover_factor_ = false_factor * missing_factor;
  make_room(nodes_, mesh.num_slots());
  make_room(boundary_, mesh.num_slots());
  make_room(piece_of_, mesh.num_face_slots());
  make_room(known_, mesh.num_slots());
  known_.clear();
  nodes_.assign(mesh.num_slots(), {});
  boundary_.assign(mesh.num_slots(), {});
  if (!keep.empty()) {
    for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
      const Keep kept = keep[mesh.vertex(v).pixel];
      if (kept != Keep::kFree) nodes_[v].factor = kept == Keep::kFixed ? kStays : keep_factor;
    }
  }
  least_loss_ = kMinLoss * surface.mean_confidence();
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    const Triangle& corners = mesh.triangle(t);
    const Vec3 a = mesh.vertex(corners[0]).point;
    const Vec3 normal =
        (mesh.vertex(corners[1]).point - a).cross(mesh.vertex(corners[2]).point - a);
    const float twice_area = normal.norm();
    if (!(twice_area > 0.0F)) continue;
    const Vec3 n = normal / twice_area;
    const float trust = confidence_of(surface, mesh, corners);
    const float loss = std::max(trust, least_loss_);
    const float third = twice_area * (1.0F / 6.0F);
    const QuadricSum plane(n, trust * third);
    for (int i = 0; i < 3; ++i) {
      Node& node = nodes_[corners[i]];
      plane.add_to(&node.surface.xx);
      node.area += loss * third;
      if (mesh.neighbors(t)[i] != Triangulation::kNone) continue;
      // The plane through the side, perpendicular to the triangle.
      const std::int32_t p = corners[(i + 1) % 3], q = corners[(i + 2) % 3];
      const Vec3 side = mesh.vertex(q).point - mesh.vertex(p).point;
      const Vec3 upright = side.cross(n);
      const float length = upright.norm();
      if (!(length > 0.0F)) continue;
      for (const std::int32_t end : {p, q}) {
        boundary_[end].add_plane_through_origin(upright / length,
                                                loss * (boundary_weight_ * length));
      }
    }
  }
  find_pieces(surface, mesh);
}

bool Collapser::is_fixed(std::int32_t v) const { return nodes_[v].factor == kStays; }

void Collapser::find_pieces(const Surface& surface, const Triangulation& mesh) {
  left_out_ = 0;
  largest_ = 0;
  has_fixed_ = false;
  // Union-find: each triangle refers to an earlier one of its piece, the first one to itself.
  piece_of_.resize(mesh.num_face_slots());
  const auto first_of = [this](std::int32_t t) {
    while (piece_of_[t] != t) t = piece_of_[t] = piece_of_[piece_of_[t]];
    return t;
  };
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    piece_of_[t] = t;
    if (!mesh.is_face(t)) continue;
    std::int32_t first = t;
    for (const std::int32_t n : mesh.neighbors(t)) {
      if (n == kNone || n > t) continue;
      const std::int32_t other = first_of(n);
      piece_of_[std::max(first, other)] = std::min(first, other);
      first = std::min(first, other);
    }
  }
  std::int32_t num_pieces = 0;
  pieces_.clear();
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t)) continue;
    if (piece_of_[t] == t) {
      piece_of_[t] = num_pieces++;
      pieces_.push_back({});
    } else {
      piece_of_[t] = piece_of_[piece_of_[t]];
    }
    const Triangle& corners = mesh.triangle(t);
    const std::int64_t doubled = mesh.orient(corners[0], corners[1], corners[2]);
    Piece& piece = pieces_[piece_of_[t]];
    piece.doubled_pixels += doubled;
    piece.believed +=
        static_cast<double>(doubled) * std::max(confidence_of(surface, mesh, corners), least_loss_);
  }
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    // A vertex has one fan, and so belongs to one piece.
    nodes_[v].piece = piece_of_[mesh.vertex(v).triangle];
    Piece& piece = pieces_[nodes_[v].piece];
    piece.area += nodes_[v].area;
    piece.fixed = piece.fixed || is_fixed(v);
    has_fixed_ = has_fixed_ || is_fixed(v);
  }
  for (std::int32_t i = 1; i < num_pieces; ++i) {
    if (pieces_[i].area > pieces_[largest_].area) largest_ = i;
  }
}

/// Sets the number of pixels, times their confidence, that the mesh will have per vertex.
void Collapser::find_share(std::int64_t target) {
  believed_sum_ = 0.0;
  for (const Piece& piece : pieces_) believed_sum_ += piece.area < 0.0 ? 0.0 : piece.believed;
  believed_share_ = believed_sum_ / static_cast<double>(target);
}

/// The price of losing pixels with a vertex, beside their area times distance. That is small for
/// near surfaces, whose pixels are small, although they may be most of the image. The price is 0
/// for fewer pixels than the mesh will have per vertex. For more it is their share of all pixels;
/// most moves cost less, so that these come last. Only few vertices can cover so much. A pixel
/// counts by its confidence, as everywhere.
float Collapser::price_of_pixels(double believed) const {
  return believed < believed_share_ ? 0.0F : static_cast<float>(believed / believed_sum_);
}

float Collapser::price(const Triangulation& mesh, std::int32_t v, std::int32_t to,
                       float cut) const {
  const Vec3 offset = mesh.vertex(to).point - mesh.vertex(v).point;
  const LocalQuadric &q = nodes_[v].surface, &r = nodes_[to].surface;
  const float squares = std::max(0.0F, q(offset)) + r.c;
  float price = std::sqrt(squares * (q.weight + r.weight)) - nodes_[v].spent - nodes_[to].spent;
  if (mesh.vertex(v).on_boundary) price += std::max(boundary_[v](offset) - boundary_[v].c, cut);
  return price * nodes_[v].factor;
}

Float4 Collapser::four_prices(const Triangulation& mesh, std::int32_t v,
                              const std::array<std::int32_t, 4>& to) const {
  const auto point_of = [&](int i) { return load4(&mesh.vertex(to[i]).point.x()); };
  static_assert(offsetof(LocalQuadric, weight) == offsetof(LocalQuadric, c) + sizeof(float) &&
                offsetof(Node, spent) == sizeof(LocalQuadric) &&
                offsetof(Node, factor) == offsetof(Node, spent) + sizeof(float));
  const auto end_of = [&](int i) { return load4(&nodes_[to[i]].surface.c); };
  const auto [to_x, to_y, to_z, flags] =
      transpose({point_of(0), point_of(1), point_of(2), point_of(3)});
  const auto [c, weight, spent, factor] = transpose({end_of(0), end_of(1), end_of(2), end_of(3)});
  const Vec3& from = mesh.vertex(v).point;
  const Node& node = nodes_[v];
  const LocalQuadric& q = node.surface;
  const Float4 x = to_x - from.x(), y = to_y - from.y(), z = to_z - from.z();
  const Float4 own = x * (q.xx * x + 2.0F * (q.xy * y + q.xz * z + q.bx)) +
                     y * (q.yy * y + 2.0F * (q.yz * z + q.by)) + z * (q.zz * z + 2.0F * q.bz) + q.c;
  const Float4 squares = (own > 0.0F ? own : all_of(0.0F)) + c;
  return (sqrt4(squares * (q.weight + weight)) - node.spent - spent) * node.factor;
}

int Collapser::cheapest_inside(const Triangulation& mesh, std::int32_t v, const Fan& fan,
                               float& lowest) const {
  // The minimum of each lane is computed first, because a branch on which of two prices is lower is
  // unpredictable.
  Float4 least = all_of(kStays);
  Int4 least_at = {0, 1, 2, 3}, at = least_at;
  for (int i = 0; i < fan.num_neighbors; i += 4, at += 4) {
    std::array<std::int32_t, 4> to{};
    for (int k = 0; k < 4; ++k) to[k] = fan.neighbors[std::min(i + k, fan.num_neighbors - 1)];
    const Float4 prices = four_prices(mesh, v, to);
    const Int4 is_lower = prices < least;
    least = is_lower ? prices : least;
    least_at = is_lower ? at : least_at;
  }
  int best = 0;
  for (int k = 1; k < 4; ++k) {
    const bool is_better =
        least[k] < least[best] || (least[k] == least[best] && least_at[k] < least_at[best]);
    best = is_better ? k : best;
  }
  lowest = least[best];
  return least_at[best];
}

int Collapser::cheapest(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                        const Fan& fan, bool legal, std::int32_t round, float& lowest) const {
  if (!legal && !mesh.vertex(v).on_boundary) return cheapest_inside(mesh, v, fan, lowest);
  // On the boundary, only along it: to the first or the last neighbour.
  const int step = mesh.vertex(v).on_boundary ? fan.num_neighbors - 1 : 1;
  float cover = 0.0F, cut = 0.0F, lost = 0.0F;
  const Triangle ends = {v, fan.neighbors[0], fan.neighbors[fan.num_neighbors - 1]};
  if (mesh.has_bay(v, fan)) {
    cover = cover_factor_ * mesh.bay(surface, v, fan).price * share_of_cover(surface, mesh, ends);
  } else if (mesh.vertex(v).on_boundary) {
    const float trust = std::max(surface.confidence(mesh.vertex(v).pixel), least_loss_);
    cut = trust * price_of_cut(boundary_weight_, mesh.vertex(fan.neighbors[0]).point,
                               mesh.vertex(v).point,
                               mesh.vertex(fan.neighbors[fan.num_neighbors - 1]).point);
    lost = price_of_pixels(trust * static_cast<double>(mesh.orient(ends[0], ends[1], ends[2])));
  }
  int best = -1;
  for (int i = 0; i < fan.num_neighbors; i += step) {
    const std::int32_t to = fan.neighbors[i];
    if (nodes_[to].touched == round) continue;
    const float p = price(mesh, v, to, cut) + (cover + lost) * nodes_[v].factor;
    if (best >= 0 && !(p < lowest)) continue;
    if (legal && !may_collapse(surface, mesh, v, fan, i)) continue;
    lowest = p;
    best = i;
  }
  return best;
}

float Collapser::price_at_rim(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                              const Fan& fan, int i) const {
  const std::int32_t to = fan.neighbors[i];
  float growth = 0.0F;
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    growth -= error_over(surface, mesh, v, a, b);
    if (a != to && b != to) growth += error_over(surface, mesh, to, a, b);
  }
  return growth * nodes_[v].factor;
}

bool Collapser::may_collapse(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                             const Fan& fan, int i) const {
  if (!mesh.can_collapse(surface, v, fan, i)) return false;
  if (!refuses_off_) return true;
  const std::int32_t to = fan.neighbors[i];
  for (int k = 0; k < fan.size; ++k) {
    const std::int32_t a = fan.neighbors[k], b = fan.next(k);
    if (a != to && b != to && face_lies_off(surface, mesh, {to, a, b})) return false;
  }
  return true;
}

float Collapser::price_of_piece(const Surface& surface, const Triangulation& mesh,
                                std::int32_t t) const {
  const auto [a, b, c] = mesh.triangle(t);
  const Piece& piece = pieces_[nodes_[a].piece];
  if (piece.fixed || nodes_[a].piece == largest_) return kStays;
  constexpr float kThird = 1.0F / 3.0F;
  const Vec3 middle = kThird * (mesh.vertex(a).point + mesh.vertex(b).point + mesh.vertex(c).point);
  const float distance = mesh.distance_to_others(surface, t, middle);
  const float kept = std::max({nodes_[a].factor, nodes_[b].factor, nodes_[c].factor});
  const float lost = price_of_pixels(piece.believed / 3.0);
  return (kThird * static_cast<float>(piece.area) * distance + lost) * kept;
}

void Collapser::find_moves(const Surface& surface, const Triangulation& mesh, float most,
                           Ticker& ticker) {
  Fan fan;
  moves_.clear();
  const auto is_expensive = [&](std::int32_t v) { return most < kStays && known_[v] > most; };
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    ticker.tick();
    const Triangulation::Vertex& vertex = mesh.vertex(v);
    if (!vertex.alive() || (is_expensive(v) && !vertex.on_boundary) || !mesh.fan(v, fan)) continue;
    if (mesh.vertex(v).on_boundary) {
      if (mesh.is_alone(fan.faces[0])) {
        if (v != mesh.triangle(fan.faces[0])[0]) continue;
        const float price = price_of_piece(surface, mesh, fan.faces[0]);
        if (price < kStays) moves_.push_back({price, v, kLeaveOut});
        continue;
      }
      const auto [first, second] = mesh.hole_of_three(surface, v);
      if (first != kNone && v < first && v < second) {
        const float cover = price_of_cover(mesh.vertex(v).point, mesh.vertex(first).point,
                                           mesh.vertex(second).point) *
                            share_of_cover(surface, mesh, {v, first, second});
        moves_.push_back({cover_factor_ * cover, v, kCloseHole});
      }
    }
    if (is_fixed(v) || is_expensive(v)) continue;
    Move move{0.0F, v, 0};
    const int i = cheapest(surface, mesh, v, fan, false, kNoRound, move.price);
    if (is_at_rim(surface, mesh, v, fan)) {
      move.price = std::max(move.price, price_at_rim(surface, mesh, v, fan, i));
    }
    if (!known_.empty()) known_[v] = move.price;
    move.to = fan.neighbors[i];
    moves_.push_back(move);
  }
}

namespace {

struct IsCheaper {
  template <typename Move>
  bool operator()(const Move& a, const Move& b) const {
    if (a.price != b.price) return a.price < b.price;
    return a.vertex < b.vertex || (a.vertex == b.vertex && a.to < b.to);
  }
};

}  // namespace

void Collapser::keep_cheapest(std::size_t count) {
  if (count >= moves_.size()) return;
  std::nth_element(moves_.begin(), moves_.begin() + static_cast<std::ptrdiff_t>(count),
                   moves_.end(), IsCheaper());
  moves_.resize(count);
}

/// Sorts the next `count` moves after the first `sorted` ones; returns the number of sorted moves.
std::size_t Collapser::sort_more(std::size_t sorted, std::size_t count) {
  const auto first = moves_.begin() + static_cast<std::ptrdiff_t>(sorted);
  const auto end = first + static_cast<std::ptrdiff_t>(std::min(count, moves_.size() - sorted));
  if (end != moves_.end()) std::nth_element(first, end, moves_.end(), IsCheaper());
  std::sort(first, end, IsCheaper());
  return static_cast<std::size_t>(end - moves_.begin());
}

bool Collapser::collapse(const Surface& surface, Triangulation& mesh, const Move& move,
                         std::int32_t round) {
  Fan fan;
  const std::int32_t v = move.vertex;
  if (nodes_[v].touched == round || !mesh.fan(v, fan)) return false;
  int i = 0;
  while (i < fan.num_neighbors && fan.neighbors[i] != move.to) ++i;
  if (i == fan.num_neighbors || nodes_[move.to].touched == round ||
      !may_collapse(surface, mesh, v, fan, i)) {
    float lowest = 0.0F;
    i = cheapest(surface, mesh, v, fan, true, round, lowest);
  }
  if (i < 0) return false;
  merge(mesh, v, fan, i);
  nodes_[v].touched = nodes_[fan.neighbors[i]].touched = round;
  return true;
}

void Collapser::merge(Triangulation& mesh, std::int32_t v, const Fan& fan, int i) {
  const std::int32_t to = fan.neighbors[i];
  const Vec3 offset = mesh.vertex(v).point - mesh.vertex(to).point;
  mesh.collapse(v, fan, i);
  nodes_[to].surface.add(nodes_[v].surface, offset);
  boundary_[to].add(boundary_[v], offset);
  nodes_[to].spent = std::sqrt(nodes_[to].surface.c * nodes_[to].surface.weight);
}

bool Collapser::may_sweep(const Triangulation& mesh, std::int32_t v, Fan& fan) const {
  return mesh.vertex(v).alive() && !is_fixed(v) && mesh.fan(v, fan) && !mesh.is_alone(fan.faces[0]);
}

/// Estimates the price below which this share of the vertices merge, from every eighth vertex.
float Collapser::sampled_price(const Surface& surface, const Triangulation& mesh, float share) {
  constexpr std::int32_t kSampleStride = 8;
  Fan fan;
  make_room(prices_, mesh.num_slots());
  prices_.clear();
  for (std::int32_t v = 0; v < mesh.num_slots(); v += kSampleStride) {
    if (!may_sweep(mesh, v, fan)) continue;
    cheapest(surface, mesh, v, fan, false, kNoRound, known_[v]);
    prices_.push_back(known_[v]);
  }
  if (prices_.empty()) return 0.0F;
  const auto at =
      prices_.begin() + static_cast<std::ptrdiff_t>(share * static_cast<float>(prices_.size() - 1));
  std::nth_element(prices_.begin(), at, prices_.end());
  return *at;
}

/// Leaves out a vertex's piece if that is a single triangle of a speck and costs at most `limit`
/// per vertex.
bool Collapser::leave_out_swept(const Surface& surface, Triangulation& mesh, std::int32_t v,
                                std::int64_t target, float limit) {
  if (swept_specks_ == 0 || !is_speck(nodes_[v].piece, largest_, swept_specks_)) return false;
  if (!mesh.vertex(v).alive() || mesh.num_vertices() - 3 < target) return false;
  const std::int32_t t = mesh.vertex(v).triangle;
  if (!mesh.is_alone(t) || !(price_of_piece(surface, mesh, t) <= limit)) return false;
  leave_out(mesh, nodes_[v].piece, {&t, 1});
  return true;
}

void Collapser::sweep_below(const Surface& surface, Triangulation& mesh, std::int64_t target,
                            float limit, Ticker& ticker) {
  Fan fan;
  for (std::int32_t v = 0; v < mesh.num_slots() && mesh.num_vertices() > target; ++v) {
    ticker.tick();
    if (known_[v] > limit || leave_out_swept(surface, mesh, v, target, limit)) continue;
    if (!may_sweep(mesh, v, fan)) continue;
    const int i = cheapest(surface, mesh, v, fan, false, kNoRound, known_[v]);
    if (i >= 0 && known_[v] <= limit && is_at_rim(surface, mesh, v, fan)) {
      known_[v] = std::max(known_[v], price_at_rim(surface, mesh, v, fan, i));
    }
    if (i < 0 || !(known_[v] <= limit) || !may_collapse(surface, mesh, v, fan, i)) continue;
    merge(mesh, v, fan, i);
    known_[fan.neighbors[i]] = 0.0F;  // its quadric changed
  }
}

/// The nearest neighbour in the image onto which a vertex may collapse, as an index in `fan`; -1 if
/// there is none. Nearest ones let the vertices around a region close over it from all sides, and
/// no fan becomes too large.
int Collapser::nearest(const Surface& surface, const Triangulation& mesh, std::int32_t v,
                       const Fan& fan, bool to_unsure) const {
  int best = -1, least = 0;
  float least_growth = kStays;
  const bool at_rim = is_at_rim(surface, mesh, v, fan);
  for (int i = 0; i < fan.num_neighbors; ++i) {
    const Triangulation::Vertex& to = mesh.vertex(fan.neighbors[i]);
    if (!to_unsure && surface.is_unsure(to.pixel)) continue;
    const int du = to.u - mesh.vertex(v).u, dv = to.v - mesh.vertex(v).v;
    const int squared = du * du + dv * dv;
    const float growth = at_rim ? std::max(0.0F, price_at_rim(surface, mesh, v, fan, i)) : 0.0F;
    if (best >= 0 && (growth > least_growth || (growth == least_growth && squared >= least))) {
      continue;
    }
    if (!may_collapse(surface, mesh, v, fan, i)) continue;
    least_growth = growth, least = squared, best = i;
  }
  return best;
}

void Collapser::leave_unsure(const Surface& surface, Triangulation& mesh, std::int64_t target,
                             const Progress& progress) {
  Ticker ticker(progress);
  Fan fan;
  refuses_off_ = false;
  const auto leaves = [&](std::int32_t v) {
    const Triangulation::Vertex& vertex = mesh.vertex(v);
    return vertex.alive() && !vertex.on_boundary && !is_fixed(v) &&
           surface.is_unsure(vertex.pixel) && mesh.fan(v, fan);
  };
  // Each pass brings sure vertices beside others. Where none may be merged into, unsure ones merge
  // into each other, which makes other collapses legal.
  bool made = true, to_unsure = false;
  while (made || !to_unsure) {
    to_unsure = !made;
    made = false;
    for (std::int32_t v = 0; v < mesh.num_slots() && mesh.num_vertices() > target; ++v) {
      ticker.tick();
      if (!leaves(v)) continue;
      const int i = nearest(surface, mesh, v, fan, to_unsure);
      if (i < 0) continue;
      merge(mesh, v, fan, i);
      made = true;
    }
  }
}

void Collapser::sweep(const Surface& surface, Triangulation& mesh, std::int64_t target,
                      float sweep_share, std::int64_t speck_pixels, const Progress& progress) {
  Ticker ticker(progress);
  refuses_off_ = false;
  swept_specks_ = speck_pixels;
  find_share(target);
  known_.assign(mesh.num_slots(), 0.0F);
  constexpr std::int64_t kLeast = 8 * kFew;
  for (;;) {
    const std::int64_t before = mesh.num_vertices();
    const std::int64_t surplus = before - target;
    if (before < kLeast || 4 * surplus < before) break;
    const float wanted = sweep_share * static_cast<float>(surplus) / static_cast<float>(before);
    sweep_below(surface, mesh, target, sampled_price(surface, mesh, wanted), ticker);
    compact(mesh);  // restores the locality of the remaining vertices in memory
    if (10 * (before - mesh.num_vertices()) < surplus) break;
  }
}

void Collapser::compact(Triangulation& mesh) {
  std::int32_t count = 0;
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (!mesh.vertex(v).alive()) continue;
    nodes_[count] = nodes_[v];
    boundary_[count] = boundary_[v];
    known_[count++] = known_[v];
  }
  nodes_.resize(count);
  boundary_.resize(count);
  known_.resize(count);
  mesh.compact();
}

/// A limit below which the known prices of `count` vertices are; kStays if there are fewer
/// vertices.
float Collapser::known_price(const Triangulation& mesh, std::int64_t count) {
  prices_.clear();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (mesh.vertex(v).alive()) prices_.push_back(known_[v]);
  }
  if (count >= static_cast<std::int64_t>(prices_.size())) return kStays;
  const auto at = prices_.begin() + static_cast<std::ptrdiff_t>(count);
  std::nth_element(prices_.begin(), at, prices_.end());
  return *at;
}

bool Collapser::make(const Surface& surface, Triangulation& mesh, const Move& move,
                     std::int32_t round, std::int64_t target) {
  if (move.to == kCloseHole) {
    const auto others = mesh.hole_of_three(surface, move.vertex);
    if (others[0] == kNone) return false;
    if (refuses_off_ && face_lies_off(surface, mesh, {move.vertex, others[0], others[1]})) {
      return false;
    }
    mesh.close_hole(move.vertex, others);
    return true;
  }
  if (move.to == kLeaveOut) {  // never below the target, which collapses reach with less error
    if (mesh.num_vertices() - 3 < target) return false;
    const std::int32_t t = mesh.vertex(move.vertex).triangle;
    leave_out(mesh, nodes_[move.vertex].piece, {&t, 1});
    return true;
  }
  return collapse(surface, mesh, move, round);
}

void Collapser::leave_out(Triangulation& mesh, std::int32_t piece,
                          std::span<const std::int32_t> faces) {
  left_out_ += pieces_[piece].doubled_pixels;
  pieces_[piece].area = -1.0;
  mesh.remove_piece(faces);
}

bool Collapser::leave_out_least(Triangulation& mesh) {
  std::int32_t least = kNone;
  for (std::int32_t i = 0; i < static_cast<std::int32_t>(pieces_.size()); ++i) {
    const Piece& piece = pieces_[i];
    if (i == largest_ || piece.fixed || piece.area < 0.0) continue;
    if (least == kNone || piece.area < pieces_[least].area) least = i;
  }
  if (least == kNone) return false;
  stack_.clear();
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (mesh.is_face(t) && nodes_[mesh.triangle(t)[0]].piece == least) stack_.push_back(t);
  }
  leave_out(mesh, least, stack_);
  return true;
}

bool Collapser::is_speck(std::int32_t piece, std::int32_t largest,
                         std::int64_t least_pixels) const {
  return piece != largest && !pieces_[piece].fixed &&
         pieces_[piece].doubled_pixels < 2 * least_pixels;
}

/// The piece with the largest area among those with at least `least_pixels`, or among all.
std::int32_t Collapser::largest_piece(std::int64_t least_pixels) const {
  std::int32_t largest = largest_;
  for (std::int32_t i = 0; i < static_cast<std::int32_t>(pieces_.size()); ++i) {
    if (pieces_[i].doubled_pixels < 2 * least_pixels) continue;
    const bool is_first = pieces_[largest].doubled_pixels < 2 * least_pixels;
    if (is_first || pieces_[i].area > pieces_[largest].area) largest = i;
  }
  return largest;
}

double Collapser::area_of_specks(std::int64_t least_pixels) const {
  const std::int32_t largest = largest_piece(least_pixels);
  double area = 0.0, specks = 0.0;
  for (std::int32_t i = 0; i < static_cast<std::int32_t>(pieces_.size()); ++i) {
    area += pieces_[i].area;
    if (is_speck(i, largest, least_pixels)) specks += pieces_[i].area;
  }
  return specks > 0.0 ? specks / area : 0.0;
}

std::int64_t Collapser::num_specks(std::int64_t least_pixels) const {
  const std::int32_t largest = largest_piece(least_pixels);
  std::int64_t count = 0;
  for (std::int32_t i = 0; i < static_cast<std::int32_t>(pieces_.size()); ++i) {
    count += is_speck(i, largest, least_pixels) ? 1 : 0;
  }
  return count;
}

void Collapser::leave_out_specks(Triangulation& mesh, std::int64_t least_pixels) {
  largest_ = largest_piece(least_pixels);
  std::vector<std::vector<std::int32_t>> faces(pieces_.size());
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t)) continue;
    const std::int32_t piece = nodes_[mesh.triangle(t)[0]].piece;
    if (is_speck(piece, largest_, least_pixels)) faces[piece].push_back(t);
  }
  for (std::int32_t i = 0; i < static_cast<std::int32_t>(pieces_.size()); ++i) {
    if (!faces[i].empty()) leave_out(mesh, i, faces[i]);
  }
}

bool Collapser::refuses_now(const Surface& surface, std::int64_t num_vertices, OffFaces off,
                            bool forced) {
  if (!surface.steps().has_steps()) return false;
  if (off == OffFaces::kNever || num_vertices == 4) return true;
  return off == OffFaces::kAvoid && num_vertices <= kFew && !forced;
}

bool Collapser::remember_few(const Surface& surface, const Triangulation& mesh,
                             std::int64_t target) {
  if (mesh.num_vertices() > few_below_) return false;
  few_below_ = mesh.num_vertices() - std::max<std::int64_t>(1, mesh.num_vertices() / 4);
  FewFaces faces = few_faces(surface, mesh, target);
  if (!few_.corners.empty() && faces.covered <= few_.covered) return false;
  few_total_ = left_out_ + doubled_pixels(mesh);
  few_ = std::move(faces);
  return true;
}

LeftOutPixels Collapser::run(const Surface& surface, Triangulation& mesh, std::int64_t target,
                             float round_share, OffFaces off, const Progress& progress) {
  Ticker ticker(progress);
  find_share(target);
  few_ = {};
  few_below_ = off == OffFaces::kNever ? kFewFrom * target : 0;
  bool all = false;     // the last round found no legal move among the cheapest
  bool forced = false;  // only moves that make triangles off the surface are left
  for (std::int32_t round = 0; mesh.num_vertices() > target; ++round) {
    const std::int64_t before = mesh.num_vertices();
    remember_few(surface, mesh, target);
    // Few vertices are removed one by one, because the second move of a round may be far worse than
    // the best of the next.
    const auto many = static_cast<float>(std::max<std::int64_t>(before - kFew, 0));
    const std::int64_t share = 1 + static_cast<std::int64_t>(round_share * many);
    const std::int64_t least = std::max(target, before - share);
    refuses_off_ = refuses_now(surface, before, off, forced);
    // After sweep(), vertices whose known price is far above the cheapest are not evaluated.
    const bool few = all || before < 8 * kFew || known_.empty();
    find_moves(surface, mesh, few ? kStays : known_price(mesh, 3 * share), ticker);
    // Half as many again, because some will not be legal or will have changed neighbours. The
    // number does not depend on the target, so that runs with lower targets begin like this one.
    if (!all) keep_cheapest(static_cast<std::size_t>(share + share / 2));
    bool made = false;
    std::size_t sorted = 0;  // sorted in parts, because the rest is not needed
    for (std::size_t i = 0; i < moves_.size() && mesh.num_vertices() > least; ++i) {
      ticker.tick();
      if (i == sorted) {
        const auto missing = static_cast<std::size_t>(mesh.num_vertices() - least);
        sorted = sort_more(sorted, missing + missing / 4 + moves_.size() / 8);
      }
      made = make(surface, mesh, moves_[i], round, target) || made;
    }
    const bool stuck = !made && all;
    if (stuck && !leave_out_least(mesh)) {  // other pieces may block collapses, as in a hole
      // For a target of 3, being forced is no way out: from four vertices, refuses_now() refuses
      // even then, and the loop would not end.
      if (!refuses_off_ || off == OffFaces::kNever || target == 3) break;
      forced = true;
      continue;
    }
    forced = forced && !made;
    all = !made;
  }
  if (has_fixed_ || (mesh.num_vertices() <= target && few_.corners.empty())) {
    return {(left_out_ + 1) / 2};
  }
  few_below_ = mesh.num_vertices();
  const bool are_of_this = remember_few(surface, mesh, target);
  mesh.assign(surface, few_.corners);
  const std::int64_t doubled = few_total_ - doubled_pixels(mesh);
  const bool are_all = are_of_this && doubled == left_out_;
  return {(doubled + 1) / 2, !are_all};
}

}  // namespace manip3d::relief_detail
