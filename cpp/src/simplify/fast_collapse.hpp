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

/// The faces around a vertex during a pass.
struct Fan {
  Bulk<Side> rest;            // the other two corners
  Bulk<std::int32_t> across;  // third corners of the faces on the edge

  void clear() {
    rest.clear();
    across.clear();
  }

  /// Appends the other ends of the edges of `rest`, sorted; each as often as its edge has faces.
  void append_ends(std::vector<std::int32_t>& ends) const {
    for (const auto& [a, b] : rest) ends.push_back(a), ends.push_back(b);
    std::sort(ends.begin(), ends.end());
  }

  /// Appends the edges of `rest` opposite the vertex, the lower end first; sorted.
  void append_sides(std::vector<Side>& sides) const {
    for (const auto& [a, b] : rest) sides.push_back({std::min(a, b), std::max(a, b)});
    std::sort(sides.begin(), sides.end());
  }
};
/// Buffers and counters of the collapses of one task.
struct CollapseTask {
  int level = 0;                   // of the block whose faces belong to the task
  std::uint32_t most = kMaxPrice;  // largest price that is allowed now
  // Largest price of an end of the edge that is allowed at once, and the price of a legal end that
  // was left for that; kNoPrice: none.
  std::uint32_t most_at_end = kMaxPrice;
  std::uint32_t end_price = kNoPrice;
  Fan first, second;  // around the two ends of the latest collapse
  std::vector<std::int32_t> ends;
  std::vector<Side> sides, twins;
  std::vector<std::int32_t> doubling;  // vertices whose faces may have become duplicates
  std::vector<Triple> twin_faces;      // vertices of faces back to back around them
  MergedWedges merged;
  std::vector<ColorMix> mixes;              // of this pass
  std::int64_t removed = 0, collapses = 0;  // removed faces; number of collapses
  float squared_error = 0.0F;
};

/// Collapses an edge if that is legal by the rules of collapse_rules.hpp. The vertex moves to the
/// minimum of the edge's quadric, or else to an end of the edge.
class EdgeCollapser {
 public:
  /// @param squared_limit  Limit of the mean squared distance to the planes, in the mesh's own
  ///                       unit.
  EdgeCollapser(FastMesh& mesh, float squared_limit) : mesh_(mesh), squared_limit_(squared_limit) {}

  /// Collapses t onto v, the lower of the two. Nothing happens, and no reason is returned, if more
  /// than `quota` faces would be removed or the edge has no faces left.
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
                                                    CollapseTask& task, Vector3f& offset) const;
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
