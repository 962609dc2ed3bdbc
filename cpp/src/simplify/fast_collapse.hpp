#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/bulk.hpp"
#include "simplify/collapse_rules.hpp"
#include "simplify/fast_attributes.hpp"
#include "simplify/fast_mesh.hpp"
#include "simplify/fast_prices.hpp"
#include "simplify/quadric_vertex.hpp"

namespace manip3d::fast_detail {

/// The faces around a vertex, in the order of a pass that has not ended.
struct Fan {
  Bulk<Side> rest;            // the other two corners
  Bulk<std::int32_t> across;  // third corners of the faces on the edge

  void clear() {
    rest.clear();
    across.clear();
  }

  /// Other ends of the edges of `rest`, sorted: each as often as the edge has faces.
  void append_ends(std::vector<std::int32_t>& ends) const {
    for (const auto& [a, b] : rest) ends.push_back(a), ends.push_back(b);
    std::sort(ends.begin(), ends.end());
  }

  /// The edges opposite the vertex, of `rest`, the lower end first; sorted.
  void append_sides(std::vector<Side>& sides) const {
    for (const auto& [a, b] : rest) sides.push_back({std::min(a, b), std::max(a, b)});
    std::sort(sides.begin(), sides.end());
  }
};
/// Buffers and counters of the collapses of one task.
struct CollapseTask {
  int level = 0;                  // of the block whose faces are the task's own
  std::uint32_t most = kDearest;  // price of what may be done now
  Fan first, second;              // around the two ends, of the latest collapse
  std::vector<std::int32_t> ends;
  std::vector<Side> sides, twins;
  std::vector<std::int32_t> doubling;  // vertices whose faces may lie on others'
  std::vector<Triple> twin_faces;      // around them: vertices of faces back to back
  MergedWedges merged;
  std::vector<ColorMix> mixes;              // of this pass
  std::int64_t removed = 0, collapses = 0;  // faces, and how many times
  float squared_error = 0.0F;
};

/// Collapses an edge if that is legal: the rules of collapse_rules.hpp, for a vertex that moves to
/// where the quadric of the edge is least, or else to an end of it.
class EdgeCollapser {
 public:
  /// @param squared_limit  on the mean squared distance to the planes, in the mesh's own unit.
  EdgeCollapser(FastMesh& mesh, float squared_limit) : mesh_(mesh), squared_limit_(squared_limit) {}

  /// Puts t into v, the lower of the two. Nothing happens, without a reason, where more than
  /// `quota` faces would go, or no face is left on the edge.
  std::optional<Rejection> collapse(std::int32_t v, std::int32_t t, CollapseTask& task,
                                    std::int64_t quota);

  [[nodiscard]] float squared_limit() const { return squared_limit_; }

  Rules rules = Rules::kAll;

 private:
  void gather(std::int32_t v, std::int32_t other, Fan& fan) const;
  [[nodiscard]] bool hangs_at_hub(const Fan& first) const;
  [[nodiscard]] bool takes_last_face_of_locked(std::int32_t v, std::int32_t t, const Fan& first,
                                               const CollapseTask& task) const;
  [[nodiscard]] bool has_complex_edge_at(std::int32_t v, std::int32_t t, CollapseTask& task) const;
  [[nodiscard]] std::optional<Rejection> check_links(std::int32_t v, std::int32_t t,
                                                     const Fan& first, const Fan& second) const;
  [[nodiscard]] std::optional<Rejection> find_place(std::int32_t v, std::int32_t t,
                                                    const EdgeQuadric<float>& edge,
                                                    const CollapseTask& task,
                                                    Vector3f& offset) const;
  [[nodiscard]] std::optional<Rejection> check_place(std::int32_t v, std::int32_t t,
                                                     const Vector3f& offset,
                                                     const EdgeQuadric<float>& edge,
                                                     const Fan& first, const Fan& second) const;
  [[nodiscard]] std::optional<Rejection> check_faces(const Fan& fan, const Vectors4& old,
                                                     const Vectors4& p) const;
  void apply(std::int32_t v, std::int32_t t, const Vector3f& offset, const EdgeQuadric<float>& edge,
             CollapseTask& task);
  void lock(std::int32_t v, std::int32_t t);

  FastMesh& mesh_;
  float squared_limit_;
};

}  // namespace manip3d::fast_detail
