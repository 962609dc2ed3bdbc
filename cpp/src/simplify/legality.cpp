#include "simplify/legality.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace manip3d {
namespace {

/// Triangles that are thinner than this in texture space show at most one texel of a 1024 x 1024
/// image, so their orientation is not preserved. (In planar mappings every face on edge is such a
/// triangle.)
constexpr double kTexel = 1.0 / 1024.0;

Eigen::Vector3d area_vector(const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                            const Eigen::Vector3d& r) {
  return (q - p).cross(r - p);
}

/// Height of a triangle over its longest edge; negative if it is clockwise.
double signed_height(const Eigen::Vector2d& p, const Eigen::Vector2d& q, const Eigen::Vector2d& r) {
  const double twice_area = (q - p).x() * (r - p).y() - (q - p).y() * (r - p).x();
  const double longest =
      std::max({(q - p).squaredNorm(), (r - q).squaredNorm(), (p - r).squaredNorm()});
  return longest > 0.0 ? twice_area / std::sqrt(longest) : 0.0;
}

bool is_degenerate(const Eigen::Vector3d& area, const Eigen::Vector3d& p, const Eigen::Vector3d& q,
                   const Eigen::Vector3d& r) {
  const double longest =
      std::max({(q - p).squaredNorm(), (r - q).squaredNorm(), (p - r).squaredNorm()});
  return !(area.norm() > kMinSine * longest);
}

}  // namespace

std::optional<Rejection> Legality::check(std::int32_t v, std::int32_t t, WedgeMap& map) {
  mesh_.gather_ring(v, ring_v_);
  mesh_.gather_ring(t, ring_t_);
  if (options_.boundary == BoundaryTerm::kCurvature && closes_boundary_loop(t)) {
    return Rejection::kBoundaryLoop;
  }
  if (options_.boundary == BoundaryTerm::kCurvature &&
      options_.complex_vertices == ComplexVertices::kFreeze &&
      classify_vertex(mesh_, ring_t_, t).is_complex) {
    return Rejection::kComplexVertex;
  }
  if (needs_link_condition(v, t) && breaks_link_condition(t)) return Rejection::kLink;
  mesh_.map_wedges(v, t, map);
  if (keeps_texture() && !map.is_complete) return Rejection::kAttribute;
  std::optional<Rejection> rejection;
  mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    if (!rejection) rejection = check_face(f, c, t, map);
  });
  return rejection;
}

/// Whether a loop of three boundary edges through v and t would shrink to two.
bool Legality::closes_boundary_loop(std::int32_t t) const {
  if (ring_v_.find(t)->num_faces != 1) return false;
  return std::any_of(ring_v_.edges().begin(), ring_v_.edges().end(), [&](const RingEdge& edge) {
    const RingEdge* other = ring_t_.find(edge.vertex);
    return edge.num_faces == 1 && other != nullptr && other->num_faces == 1;
  });
}

bool Legality::needs_link_condition(std::int32_t v, std::int32_t t) const {
  switch (options_.link_condition) {
    case LinkCondition::kAlways:
      return true;
    case LinkCondition::kNever:
      return false;
    case LinkCondition::kManifold:
      break;
  }
  return classify_vertex(mesh_, ring_v_, v).is_manifold &&
         classify_vertex(mesh_, ring_t_, t).is_manifold;
}

/// The links of v and t must meet only in the link of the edge [Dey et al. 1999]. A boundary counts
/// as an additional vertex connected to all its edges, so an edge between two boundary vertices
/// must itself be on the boundary.
bool Legality::breaks_link_condition(std::int32_t t) const {
  std::int64_t shared = 0;
  bool v_boundary = false, t_boundary = false;
  for (const RingEdge& edge : ring_v_.edges()) {
    v_boundary |= edge.num_faces == 1;
    shared += ring_t_.find(edge.vertex) != nullptr ? 1 : 0;
  }
  for (const RingEdge& edge : ring_t_.edges()) t_boundary |= edge.num_faces == 1;
  const std::int32_t edge_faces = ring_v_.find(t)->num_faces;
  if (v_boundary && t_boundary && edge_faces != 1) return true;
  // Each face on the edge has a third vertex of its own, because duplicate faces are not manifold.
  return shared != edge_faces;
}

std::optional<Rejection> Legality::check_face(std::int32_t f, std::int32_t c, std::int32_t t,
                                              const WedgeMap& map) const {
  const auto& face = mesh_.face(f);
  const auto own = c, next = (c + 1) % 3, last = (c + 2) % 3;
  const std::int32_t a = face[next], b = face[last];
  if (a == t || b == t) return std::nullopt;  // it is removed with the edge
  if (ring_t_.find(a) != nullptr && ring_t_.find(b) != nullptr && has_face(t, a, b)) {
    return Rejection::kDuplicate;
  }
  const Eigen::Vector3d &pa = mesh_.position(a), &pb = mesh_.position(b);
  const Eigen::Vector3d before = area_vector(mesh_.position(face[own]), pa, pb);
  const Eigen::Vector3d after = area_vector(mesh_.position(t), pa, pb);
  if (is_degenerate(after, mesh_.position(t), pa, pb)) return Rejection::kDegenerate;
  const bool had_area = before.squaredNorm() > 0.0;
  if (had_area && !(before.dot(after) > kMinNormalCosine * before.norm() * after.norm())) {
    return Rejection::kFlip;
  }
  const auto& wedges = mesh_.wedges(f);
  if (!keeps_texture() || !mesh_.has_texture(wedges[own])) return std::nullopt;
  const Eigen::Vector2d &ua = mesh_.uv(wedges[next]), &ub = mesh_.uv(wedges[last]);
  const double uv_before = signed_height(mesh_.uv(wedges[own]), ua, ub);
  const double uv_after = signed_height(mesh_.uv(map.at(wedges[own])), ua, ub);
  const bool turns_over = std::signbit(uv_before) != std::signbit(uv_after);
  if (turns_over && std::max(std::abs(uv_before), std::abs(uv_after)) > kTexel) {
    return Rejection::kTextureFlip;
  }
  return std::nullopt;
}

bool Legality::has_face(std::int32_t t, std::int32_t a, std::int32_t b) const {
  bool found = false;
  mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t) {
    const auto& face = mesh_.face(f);
    const auto contains = [&](std::int32_t w) {
      return face[0] == w || face[1] == w || face[2] == w;
    };
    found |= contains(a) && contains(b);
  });
  return found;
}

}  // namespace manip3d
