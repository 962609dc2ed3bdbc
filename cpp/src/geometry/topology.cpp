#include "manip3d/geometry/topology.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "geometry/buckets.hpp"
#include "geometry/union_find.hpp"

namespace manip3d {
namespace {

/// The end of an edge with the higher index, and a face that uses the edge.
struct EdgeUse {
  std::int32_t upper;
  std::int32_t face;
  auto operator<=>(const EdgeUse&) const = default;
};

Buckets<EdgeUse> edge_uses_by_lower_vertex(const Eigen::Ref<const Faces>& faces,
                                           std::int64_t num_vertices) {
  Buckets<EdgeUse> uses(num_vertices, [&](const auto& put) {
    for (std::int32_t f = 0; f < faces.rows(); ++f) {
      if (is_degenerate(faces, f)) continue;
      for (int c = 0; c < 3; ++c) {
        const auto [lower, upper] = std::minmax({faces(f, c), faces(f, (c + 1) % 3)});
        put(lower, EdgeUse{upper, f});
      }
    }
  });
  for (std::int32_t v = 0; v < uses.num_keys(); ++v) std::sort(uses[v].begin(), uses[v].end());
  return uses;
}

}  // namespace

Edges find_edges(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices) {
  Buckets<EdgeUse> uses = edge_uses_by_lower_vertex(faces, num_vertices);
  Edges edges;
  edges.vertices.resize(3 * faces.rows(), 2);
  edges.faces.reserve(3 * faces.rows());
  Eigen::Index size = 0;
  for (std::int32_t lower = 0; lower < uses.num_keys(); ++lower) {
    std::int32_t last_upper = -1;
    for (const EdgeUse& use : uses[lower]) {
      if (use.upper != last_upper) {
        edges.vertices.row(size++) << lower, use.upper;
        edges.offsets.push_back(static_cast<std::int32_t>(edges.faces.size()));
        last_upper = use.upper;
      }
      edges.faces.push_back(use.face);
    }
  }
  edges.offsets.push_back(static_cast<std::int32_t>(edges.faces.size()));
  edges.vertices.conservativeResize(size, 2);
  return edges;
}

Indices count_boundary_neighbors(const Edges& edges, std::int64_t num_vertices) {
  Indices neighbors = Indices::Zero(num_vertices);
  for (Eigen::Index e = 0; e < edges.size(); ++e) {
    if (!edges.is_boundary(e)) continue;
    ++neighbors[edges.vertices(e, 0)];
    ++neighbors[edges.vertices(e, 1)];
  }
  return neighbors;
}

Components find_components(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices) {
  UnionFind sets(num_vertices);
  Components components{Indices::Constant(num_vertices, -1), 0};
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    if (is_degenerate(faces, f)) continue;
    for (int c = 0; c < 3; ++c) {
      components.of_vertex[faces(f, c)] = 0;  // marks it as used; numbered below
      sets.join(faces(f, c), faces(f, (c + 1) % 3));
    }
  }
  for (std::int32_t v = 0; v < num_vertices; ++v) {
    if (components.of_vertex[v] < 0) continue;
    const std::int32_t root = sets.root(v);
    components.of_vertex[v] = root == v ? components.count++ : components.of_vertex[root];
  }
  return components;
}

std::int64_t count_duplicate_faces(const Eigen::Ref<const Faces>& faces,
                                   std::int64_t num_vertices) {
  using Pair = std::array<std::int32_t, 2>;  // the middle and the highest vertex
  Buckets<Pair> by_lowest(num_vertices, [&](const auto& put) {
    for (Eigen::Index f = 0; f < faces.rows(); ++f) {
      if (is_degenerate(faces, f)) continue;
      std::array<std::int32_t, 3> v{faces(f, 0), faces(f, 1), faces(f, 2)};
      std::sort(v.begin(), v.end());
      put(v[0], Pair{v[1], v[2]});
    }
  });
  std::int64_t duplicates = 0;
  for (std::int32_t v = 0; v < by_lowest.num_keys(); ++v) {
    const std::span<Pair> pairs = by_lowest[v];
    std::sort(pairs.begin(), pairs.end());
    duplicates += pairs.end() - std::unique(pairs.begin(), pairs.end());
  }
  return duplicates;
}

}  // namespace manip3d
