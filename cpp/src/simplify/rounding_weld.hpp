#pragma once

#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// A mesh whose edges that only rounding gives a length have none: the poles of surfaces of
/// revolution as many programs write them, where sin(pi) is not 0. The two ends of an edge are one
/// if it is as short as a millionth of the mesh's diagonal and as a thousandth of the longest edge
/// at each end: a part of that size is not a rounding. Locked vertices stay by themselves.
class RoundingWeld {
 public:
  /// @param mesh    Outlives this.
  /// @param locked  of a vertex; empty: none.
  RoundingWeld(const MeshView& mesh, const std::vector<bool>& locked);
  RoundingWeld(const RoundingWeld&) = delete;
  RoundingWeld& operator=(const RoundingWeld&) = delete;
  ~RoundingWeld() = default;

  /// The mesh with faces of the vertices that are left; some have a repeated vertex.
  [[nodiscard]] const MeshView& mesh() const { return mesh_; }
  /// Gives vertices that went into others the entries of those.
  void complete(std::vector<std::int32_t>& vertex_map) const;

 private:
  MeshView mesh_;
  Indices into_;  // of a vertex: the one that it is part of; empty: none went
  Faces faces_;   // empty: those of the file
};

}  // namespace manip3d
