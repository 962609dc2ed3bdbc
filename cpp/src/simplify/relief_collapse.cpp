#include "simplify/relief_collapse.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace manip3d::relief_detail {
namespace {

// Per length and squared distance, on a surface of diagonal 1; chosen on the bunny's scans.
constexpr float kBoundaryWeight = 0.05F;
constexpr std::int32_t kNever = -1, kNoRound = -2;
constexpr float kStays = std::numeric_limits<float>::infinity();

using Fan = Triangulation::Fan;

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

void Collapser::assign(const Triangulation& mesh, std::span<const Keep> keep, float keep_factor) {
  for (auto* numbers : {&factor_, &spent_}) make_room(*numbers, mesh.num_slots());
  for (auto* quadrics : {&surface_, &boundary_}) make_room(*quadrics, mesh.num_slots());
  make_room(touched_, mesh.num_slots());
  factor_.assign(mesh.num_slots(), 1.0F);
  if (!keep.empty()) {
    for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
      const Keep kept = keep[mesh.vertex(v).pixel];
      if (kept != Keep::kFree) factor_[v] = kept == Keep::kFixed ? kStays : keep_factor;
    }
  }
  surface_.assign(mesh.num_slots(), {});
  boundary_.assign(mesh.num_slots(), {});
  spent_.assign(mesh.num_slots(), 0.0F);
  touched_.assign(mesh.num_slots(), kNever);
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    const Triangle& corners = mesh.triangle(t);
    const Vec3 a = mesh.vertex(corners[0]).point;
    const Vec3 normal =
        (mesh.vertex(corners[1]).point - a).cross(mesh.vertex(corners[2]).point - a);
    const float twice_area = normal.norm();
    if (!(twice_area > 0.0F)) continue;
    const Vec3 n = normal / twice_area;
    for (int i = 0; i < 3; ++i) {
      surface_[corners[i]].add_plane_through_origin(n, twice_area * (1.0F / 6.0F));
      if (mesh.neighbors(t)[i] != Triangulation::kNone) continue;
      // The plane along the side, upright on the triangle.
      const std::int32_t p = corners[(i + 1) % 3], q = corners[(i + 2) % 3];
      const Vec3 side = mesh.vertex(q).point - mesh.vertex(p).point;
      const Vec3 upright = side.cross(n);
      const float length = upright.norm();
      if (!(length > 0.0F)) continue;
      for (const std::int32_t end : {p, q}) {
        boundary_[end].add_plane_through_origin(upright / length, kBoundaryWeight * length);
      }
    }
  }
}

float Collapser::price(const Triangulation& mesh, std::int32_t v, std::int32_t to) const {
  const Vec3 offset = mesh.vertex(to).point - mesh.vertex(v).point;
  const LocalQuadric &q = surface_[v], &r = surface_[to];
  const float squares = std::max(0.0F, q(offset)) + r.c;
  float price = std::sqrt(squares * (q.weight + r.weight)) - spent_[v] - spent_[to];
  if (mesh.vertex(v).on_boundary) price += boundary_[v](offset) - boundary_[v].c;
  return price * factor_[v];
}

int Collapser::cheapest(const Triangulation& mesh, std::int32_t v, const Fan& fan,
                        const Surface* legal_on, std::int32_t round, float& lowest) const {
  // Along the boundary only, to the first or the last neighbour.
  const int step = mesh.vertex(v).on_boundary ? fan.num_neighbors - 1 : 1;
  int best = -1;
  for (int i = 0; i < fan.num_neighbors; i += step) {
    const std::int32_t to = fan.neighbors[i];
    if (touched_[to] == round) continue;
    const float p = price(mesh, v, to);
    if (best >= 0 && !(p < lowest)) continue;
    if (legal_on != nullptr && !mesh.can_collapse(*legal_on, v, fan, i)) continue;
    lowest = p;
    best = i;
  }
  return best;
}

void Collapser::find_moves(const Triangulation& mesh) {
  Fan fan;
  moves_.clear();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (!mesh.vertex(v).alive() || factor_[v] == kStays || !mesh.fan(v, fan)) continue;
    Move move{0.0F, v, 0};
    const int i = cheapest(mesh, v, fan, nullptr, kNoRound, move.price);
    move.to = fan.neighbors[i];
    moves_.push_back(move);
  }
}

void Collapser::sort_moves(std::size_t count) {
  const auto cheaper = [](const Move& a, const Move& b) {
    return a.price < b.price || (a.price == b.price && a.vertex < b.vertex);
  };
  if (count < moves_.size()) {
    const auto end = moves_.begin() + static_cast<std::ptrdiff_t>(count);
    std::nth_element(moves_.begin(), end, moves_.end(), cheaper);
    moves_.resize(count);
  }
  std::sort(moves_.begin(), moves_.end(), cheaper);
}

bool Collapser::collapse(const Surface& surface, Triangulation& mesh, const Move& move,
                         std::int32_t round) {
  Fan fan;
  const std::int32_t v = move.vertex;
  if (touched_[v] == round || !mesh.fan(v, fan)) return false;
  int i = 0;
  while (i < fan.num_neighbors && fan.neighbors[i] != move.to) ++i;
  if (i == fan.num_neighbors || touched_[move.to] == round ||
      !mesh.can_collapse(surface, v, fan, i)) {
    float lowest = 0.0F;
    i = cheapest(mesh, v, fan, &surface, round, lowest);
  }
  if (i < 0) return false;
  const std::int32_t to = fan.neighbors[i];
  const Vec3 offset = mesh.vertex(v).point - mesh.vertex(to).point;
  mesh.collapse(v, fan, i);
  surface_[to].add(surface_[v], offset);
  boundary_[to].add(boundary_[v], offset);
  spent_[to] = std::sqrt(surface_[to].c * surface_[to].weight);
  touched_[v] = touched_[to] = round;
  return true;
}

void Collapser::run(const Surface& surface, Triangulation& mesh, std::int64_t target,
                    float round_share) {
  bool all = false;  // the last round found none among the cheapest
  for (std::int32_t round = 0; mesh.num_vertices() > target; ++round) {
    const std::int64_t share =
        1 + static_cast<std::int64_t>(round_share * static_cast<float>(mesh.num_vertices()));
    const std::int64_t wanted = std::min(share, mesh.num_vertices() - target);
    find_moves(mesh);
    // Half as many again, because some will not be legal or will have changed neighbours; as for
    // any lower target, so that lower targets continue where this one stops.
    sort_moves(all ? moves_.size() : static_cast<std::size_t>(share + share / 2));
    std::int64_t done = 0;
    for (std::size_t i = 0; i < moves_.size() && done < wanted; ++i) {
      done += collapse(surface, mesh, moves_[i], round) ? 1 : 0;
    }
    if (done == 0 && all) return;
    all = done == 0;
  }
}

std::int64_t drop_small_pieces(Triangulation& mesh, std::int64_t target,
                               std::span<const Keep> keep) {
  struct Piece {
    bool fixed = false;
    std::int64_t pixels = 0;  // twice the area
    std::vector<std::int32_t> faces;
  };
  const auto is_fixed = [&](std::int32_t v) {
    return !keep.empty() && keep[mesh.vertex(v).pixel] == Keep::kFixed;
  };
  std::vector<Piece> pieces;
  std::vector<bool> seen(mesh.num_face_slots());
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t) || seen[t]) continue;
    Piece piece;
    piece.faces.push_back(t);
    seen[t] = true;
    for (std::size_t i = 0; i < piece.faces.size(); ++i) {
      const Triangle& f = mesh.triangle(piece.faces[i]);
      piece.pixels += mesh.orient(f[0], f[1], f[2]);
      piece.fixed = piece.fixed || std::any_of(f.begin(), f.end(), is_fixed);
      for (const std::int32_t n : mesh.neighbors(piece.faces[i])) {
        if (n == Triangulation::kNone || seen[n]) continue;
        seen[n] = true;
        piece.faces.push_back(n);
      }
    }
    pieces.push_back(std::move(piece));
  }
  std::stable_sort(pieces.begin(), pieces.end(), [](const Piece& a, const Piece& b) {
    return std::tie(a.fixed, a.pixels) < std::tie(b.fixed, b.pixels);
  });
  std::int64_t dropped = 0;
  for (auto piece = pieces.begin(); piece != pieces.end() && mesh.num_vertices() > target;
       ++piece) {
    mesh.remove_piece(piece->faces);
    dropped += piece->pixels;
  }
  return (dropped + 1) / 2;
}

}  // namespace manip3d::relief_detail
