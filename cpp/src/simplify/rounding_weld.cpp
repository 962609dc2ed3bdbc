#include "simplify/rounding_weld.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <new>
#include <numeric>
#include <tuple>
#include <utility>
#include <vector>

#include "manip3d/geometry/topology.hpp"

namespace manip3d {
namespace {

/// Largest distance for welding, relative to the longest edge at a vertex.
constexpr double kFarthestOfEdges = 1e-3;

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
        farthest_(RoundingWeld::kFarthestOfDiagonal * bounding_box(mesh).diagonal()),
        reach_(mesh.num_vertices(), 0.0) {
    bool has_short_edges = false;  // no reach is longer, also not that of a place
    for_each_edge(mesh, [&](std::int32_t a, std::int32_t b) {
      has_short_edges |= a != b && distance(a, b) <= farthest_;
    });
    if (!has_short_edges) return;
    find_reaches(locked);
    find_places();
    into_ = place_;
    is_joined_.assign(mesh.num_vertices(), false);
    for_each_edge(mesh, [&](std::int32_t a, std::int32_t b) { join(a, b); });
    any_ = std::find(is_joined_.begin(), is_joined_.end(), true) != is_joined_.end();
  }

  [[nodiscard]] bool any() const { return any_; }
  /// The vertex into which each one was welded.
  [[nodiscard]] Indices take() {
    for (std::int32_t v = 0; v < into_.size(); ++v) {
      const std::int32_t to = root(place_[v]);
      into_[v] = is_joined_[to] ? to : v;
    }
    return std::move(into_);
  }

 private:
  [[nodiscard]] double distance(std::int32_t a, std::int32_t b) const {
    return (mesh_.vertices.row(a) - mesh_.vertices.row(b)).norm();
  }
  [[nodiscard]] bool are_near(std::int32_t a, std::int32_t b) const {
    return a != b && distance(a, b) <= std::min(reach_[a], reach_[b]);
  }

  /// Finds the reach of each vertex; find_places() then gives all at one position the longest one.
  void find_reaches(const std::vector<bool>& locked) {
    for_each_edge(mesh_, [&](std::int32_t a, std::int32_t b) {
      const double length = kFarthestOfEdges * distance(a, b);
      reach_[a] = std::max(reach_[a], length);
      reach_[b] = std::max(reach_[b], length);
    });
    for (std::size_t v = 0; v < reach_.size(); ++v) {
      reach_[v] = !locked.empty() && locked[v] ? kLocked : std::min(reach_[v], farthest_);
    }
  }

  /// Finds the lowest vertex at the position of each one. Vertices at one position are welded
  /// together or not at all, so that faces that share only the position are not torn apart.
  void find_places() {
    const auto position = [&](std::int32_t v) {
      const double* p = mesh_.vertices.data() + 3 * static_cast<std::ptrdiff_t>(v);
      return std::tie(p[0], p[1], p[2]);
    };
    std::vector<std::int32_t> order(mesh_.num_vertices());
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
      return position(a) != position(b) ? position(a) < position(b) : a < b;
    });
    place_.resize(mesh_.num_vertices());
    for (std::size_t i = 0; i < order.size(); ++i) {
      const std::int32_t v = order[i];
      const bool is_first = i == 0 || position(v) != position(order[i - 1]);
      place_[v] = is_first ? v : place_[order[i - 1]];
      double& reach = reach_[place_[v]];
      reach = std::min(reach, reach_[v]) < 0.0 ? kLocked : std::max(reach, reach_[v]);
    }
  }

  /// Welds the higher of two vertices, with all vertices already welded to it, to the lower one.
  /// The representatives of both must be near each other, so that a chain of vertices does not
  /// become one.
  void join(std::int32_t a, std::int32_t b) {
    const auto [low, high] = std::minmax({root(place_[a]), root(place_[b])});
    if (!are_near(low, high)) return;
    into_[high] = low;
    is_joined_[low] = true;
  }

  [[nodiscard]] std::int32_t root(std::int32_t v) const {
    while (into_[v] != v) v = into_[v];
    return v;
  }

  static constexpr double kLocked = -1.0;

  const MeshView& mesh_;
  double farthest_;
  std::vector<double> reach_;  // by vertex: largest distance for welding, or kLocked
  Indices place_;              // by vertex: the lowest one at its position
  Indices into_;
  std::vector<bool> is_joined_;  // by vertex: whether others were welded to it
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
