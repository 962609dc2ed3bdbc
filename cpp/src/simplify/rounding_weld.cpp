#include "simplify/rounding_weld.hpp"

#include <algorithm>
#include <cstdint>
#include <new>
#include <numeric>
#include <utility>
#include <vector>

#include "manip3d/geometry/topology.hpp"

namespace manip3d {
namespace {

/// Relative to the diagonal. Coordinates in single precision that were computed from angles, or
/// shifted by a few diagonals, have errors of 1e-7 to 5e-7 of it, and so have files with six
/// decimals.
constexpr double kFarthest = 1e-6;

/// Relative to the longest edge at a vertex.
constexpr double kFarthestOfEdge = 1e-3;

/// Calls body(a, b) for each edge of each face.
template <typename Body>
void for_each_edge(const MeshView& mesh, const Body& body) {
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    for (int c = 0; c < 3; ++c) body(mesh.faces(f, c), mesh.faces(f, (c + 1) % 3));
  }
}

class NearVertices {
 public:
  NearVertices(const MeshView& mesh, const std::vector<bool>& locked)
      : mesh_(mesh),
        farthest_(kFarthest * bounding_box(mesh).diagonal()),
        reach_(mesh.num_vertices(), 0.0),
        into_(mesh.num_vertices()) {
    std::iota(into_.begin(), into_.end(), 0);
    measure(locked);
    for_each_edge(mesh, [&](std::int32_t a, std::int32_t b) { join(a, b); });
  }

  [[nodiscard]] bool any() const { return any_; }
  /// The vertex into which each one was welded.
  [[nodiscard]] Indices take() {
    for (std::int32_t v = 0; v < into_.size(); ++v) into_[v] = root(v);
    return std::move(into_);
  }

 private:
  [[nodiscard]] double distance(std::int32_t a, std::int32_t b) const {
    return (mesh_.vertices.row(a) - mesh_.vertices.row(b)).norm();
  }

  void measure(const std::vector<bool>& locked) {
    for_each_edge(mesh_, [&](std::int32_t a, std::int32_t b) {
      const double length = kFarthestOfEdge * distance(a, b);
      reach_[a] = std::max(reach_[a], length);
      reach_[b] = std::max(reach_[b], length);
    });
    for (std::size_t v = 0; v < reach_.size(); ++v) {
      reach_[v] = !locked.empty() && locked[v] ? -1.0 : std::min(reach_[v], farthest_);
    }
  }

  /// Welds the higher of two vertices, with all vertices already welded to it, to the lower one.
  /// The representatives of both must be near each other, so that a chain of vertices does not
  /// become one.
  void join(std::int32_t a, std::int32_t b) {
    const auto [low, high] = std::minmax({root(a), root(b)});
    if (low == high || !(distance(low, high) <= std::min(reach_[low], reach_[high]))) return;
    into_[high] = low;
    any_ = true;
  }

  [[nodiscard]] std::int32_t root(std::int32_t v) const {
    while (into_[v] != v) v = into_[v];
    return v;
  }

  const MeshView& mesh_;
  double farthest_;
  std::vector<double> reach_;  // by vertex: largest distance for welding; < 0: none
  Indices into_;
  bool any_ = false;
};

}  // namespace

RoundingWeld::RoundingWeld(const MeshView& mesh, const std::vector<bool>& locked) : mesh_(mesh) {
  NearVertices near(mesh, locked);
  if (!near.any()) return;
  into_ = near.take();
  faces_ = mesh.faces.unaryExpr([&](std::int32_t v) { return into_[v]; });
  bool has_faces = false;
  for (Eigen::Index f = 0; f < faces_.rows(); ++f) has_faces |= !is_degenerate(faces_, f);
  if (!has_faces) {  // only needles: leave the mesh unchanged
    into_.resize(0);
    return;
  }
  using Map = MeshView::Map<Faces>;
  new (&mesh_.faces) Map(faces_.data(), faces_.rows(), 3);  // Eigen's way to rebind a map
}

void RoundingWeld::complete(std::vector<std::int32_t>& vertex_map) const {
  for (std::int32_t v = 0; v < into_.size(); ++v) {
    if (into_[v] != v) vertex_map[v] = vertex_map[into_[v]];
  }
}

}  // namespace manip3d
