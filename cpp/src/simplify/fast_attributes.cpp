#include "simplify/fast_attributes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <limits>
#include <optional>

namespace manip3d::fast_detail {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

std::int32_t continued(std::int32_t wedge, const WedgePairs& pairs) {
  for (const auto& [from, to] : pairs) {
    if (from == wedge) return to;
  }
  return wedge;
}

/// The texture coordinate at p, continued linearly from that face of the wedge over which p lies,
/// or which is nearest to it. It is clamped to the coordinates around, because the continuation of
/// a narrow face can be anywhere. Faces are those before the collapse of v and t.
Vector2d texture_at(const FastMesh& mesh, std::int32_t wedge, std::int32_t v, std::int32_t t,
                    const Vector3f& p, const WedgePairs& pairs) {
  Vector2d best = mesh.table.texcoords[wedge];
  Vector2d low = best, high = best;
  double most_inside = -std::numeric_limits<double>::infinity();
  // The exact coordinate of a locked vertex, which rounding would separate from its neighbours.
  std::optional<Vector2d> own;
  for (const std::int32_t from : {v, t}) {
    const Vector3d origin = position_of(mesh.vertices[from]).cast<double>();
    mesh.for_each_face(from, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
      const Triple& w = mesh.wedges[f];
      if (continued(w[c], pairs) != wedge || mesh.remap[a] == mesh.remap[b]) return;
      const Vector2d uv = mesh.table.texcoords[w[c]];
      if (mesh.is_locked(from)) own = uv;
      const Vector2d ua = mesh.table.texcoords[mesh.wedge_into[w[after(c)]]];
      const Vector2d ub = mesh.table.texcoords[mesh.wedge_into[w[before(c)]]];
      for (const Vector2d& s : {uv, ua, ub}) {
        low = low.cwiseMin(s);
        high = high.cwiseMax(s);
      }
      const Vector3d ea = position_of(mesh.vertices[mesh.remap[a]]).cast<double>() - origin;
      const Vector3d eb = position_of(mesh.vertices[mesh.remap[b]]).cast<double>() - origin;
      const Vector3d normal = ea.cross(eb), d = p.cast<double>() - origin;
      const double squared = normal.squaredNorm();
      if (!(squared > 0.0)) return;
      const double share_a = d.cross(eb).dot(normal) / squared;
      const double share_b = ea.cross(d).dot(normal) / squared;
      const double inside = std::min({1.0 - share_a - share_b, share_a, share_b});
      if (!(inside > most_inside)) return;
      most_inside = inside;
      best = uv + share_a * (ua - uv) + share_b * (ub - uv);
    });
  }
  return own ? *own : best.cwiseMax(low).cwiseMin(high);
}

/// Finds, for the wedges of t on the faces of its edge with v, those of v that replace them.
void pair_wedges(const FastMesh& mesh, std::int32_t v, std::int32_t t, WedgePairs& pairs) {
  pairs.clear();
  const auto find = [&](std::int32_t from) {
    return std::find_if(pairs.begin(), pairs.end(),
                        [&](const auto& pair) { return pair.first == from; });
  };
  mesh.for_each_face(t, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
    const std::int32_t from = mesh.wedges[f][c];
    if ((a != v && b != v) || mesh.remap[a] == mesh.remap[b] || find(from) != pairs.end()) return;
    pairs.emplace_back(from, mesh.wedges[f][a == v ? after(c) : before(c)]);
  });
}

}  // namespace

bool changes_locked(const FastMesh& mesh, std::int32_t v, std::int32_t t, MergedWedges& merged) {
  const bool stays_first = mesh.is_locked(v);
  if (stays_first == mesh.is_locked(t)) return false;
  pair_wedges(mesh, v, t, merged.pairs);
  const auto [fixed, other] = stays_first ? std::pair(v, t) : std::pair(t, v);
  bool changes = false;
  mesh.for_each_face(other, [&](std::uint32_t f, std::uint32_t c, std::int32_t a, std::int32_t b) {
    const std::int32_t wedge = mesh.wedges[f][c], x = mesh.remap[a], y = mesh.remap[b];
    if (x == y || x == fixed || y == fixed || !mesh.table.has_texture(wedge)) return;
    changes = changes || std::ranges::none_of(merged.pairs, [&](const auto& pair) {
                return (stays_first ? pair.first : pair.second) == wedge;
              });
  });
  return changes;
}

void merge_wedges(FastMesh& mesh, std::int32_t v, std::int32_t t, const Vector3f& p,
                  MergedWedges& merged) {
  auto& pairs = merged.pairs;
  pair_wedges(mesh, v, t, pairs);
  merged.wedges.clear();
  for (const std::int32_t from : {v, t}) {
    mesh.for_each_face(from, [&](std::uint32_t f, std::uint32_t c, std::int32_t, std::int32_t) {
      const std::int32_t wedge = continued(mesh.wedges[f][c], pairs);
      auto& known = merged.wedges;
      if (!mesh.table.has_texture(wedge) ||
          std::find(known.begin(), known.end(), wedge) != known.end()) {
        return;
      }
      known.push_back(wedge);
    });
  }
  merged.texcoords.clear();
  for (const std::int32_t wedge : merged.wedges) {
    merged.texcoords.push_back(texture_at(mesh, wedge, v, t, p, pairs));
  }
  for (std::size_t i = 0; i < merged.wedges.size(); ++i) {
    mesh.table.texcoords[merged.wedges[i]] = merged.texcoords[i];
  }
  for (const auto& [from, to] : pairs) mesh.wedge_into[from] = to;
}

void merge_normals(FastMesh& mesh, std::int32_t v, std::int32_t t) {
  mesh.for_each_face(t, [&](std::uint32_t f, std::uint32_t c, std::int32_t, std::int32_t) {
    std::int32_t& normal = mesh.normals[f][c];
    if (normal < 0) return;
    const auto own = mesh.input.normals.row(normal);
    std::int32_t nearest = normal;
    double most = -std::numeric_limits<double>::infinity();
    mesh.for_each_face(v, [&](std::uint32_t g, std::uint32_t k, std::int32_t, std::int32_t) {
      const std::int32_t other = mesh.normals[g][k];
      if (other < 0) return;
      const double cosine = mesh.input.normals.row(other).dot(own);
      if (cosine > most || (cosine == most && other < nearest)) {
        most = cosine;
        nearest = other;
      }
    });
    normal = nearest;
  });
}

ColorMix mix_of(const FastMesh& mesh, std::int32_t v, std::int32_t t, const Vector3f& p) {
  const Vector3f origin = position_of(mesh.vertices[v]),
                 edge = position_of(mesh.vertices[t]) - origin;
  const float squared = edge.squaredNorm();
  const float share =
      squared > 0.0F ? std::clamp((p - origin).dot(edge) / squared, 0.0F, 1.0F) : 1.0F;
  return {v, t, share};
}

void mix_colors(FastMesh& mesh, const std::vector<ColorMix>& mixes) {
  for (const auto& [v, t, share] : mixes) {
    Vector3f& color = mesh.colors[mesh.id[v]];
    color += share * (mesh.colors[mesh.id[t]] - color);
  }
}

}  // namespace manip3d::fast_detail
