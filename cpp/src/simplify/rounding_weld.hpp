#pragma once

#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Welds vertices whose distance is only due to rounding, as at the poles of surfaces of revolution
/// in files of many programs, where sin(pi) is not 0. The two ends of an edge are welded if it is
/// shorter than a millionth of the mesh's diagonal and than a thousandth of the longest edge at
/// each end. The second condition protects real parts of the mesh as small as a millionth, whose
/// edges are all short. Vertices at one position are welded together, and not at all if one of them
/// is locked.
class RoundingWeld {
 public:
  /// Largest distance for welding, relative to the diagonal. Coordinates in single precision that
  /// were computed from angles, or shifted by a few diagonals, have errors of 1e-7 to 5e-7 of it,
  /// and so have files with six decimals.
  static constexpr double kFarthestOfDiagonal = 1e-6;

  /// @param mesh    Must outlive this object.
  /// @param locked  By vertex; empty: none.
  RoundingWeld(const MeshView& mesh, const std::vector<bool>& locked);
  RoundingWeld(const RoundingWeld&) = delete;
  RoundingWeld& operator=(const RoundingWeld&) = delete;
  ~RoundingWeld() = default;

  /// Whether some vertices were welded.
  [[nodiscard]] bool any() const { return into_.size() > 0; }
  /// The mesh with faces of the remaining vertices; some faces have a repeated vertex.
  [[nodiscard]] const MeshView& mesh() const { return mesh_; }
  /// Copies the entries of the remaining vertices to the vertices welded to them.
  void complete(std::vector<std::int32_t>& vertex_map) const;

 private:
  MeshView mesh_;
  Indices into_;  // by vertex: the one to which it was welded; empty: none was
  Faces faces_;   // those of mesh(); empty if no vertices were welded
};

}  // namespace manip3d
