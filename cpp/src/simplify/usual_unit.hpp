#pragma once

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// A mesh that is scaled by a power of two if its diagonal is outside 2^-200 to 2^200, so that
/// products of several lengths neither overflow nor underflow; other meshes are not changed.
/// Scaling by a power of two causes no rounding, so the result is the same at any scale, up to that
/// factor, to the last bit.
class UsualUnit {
 public:
  /// @param mesh  Must outlive this object.
  /// @throws InputError  the diagonal of its bounding box is not a finite number.
  explicit UsualUnit(const MeshView& mesh);
  UsualUnit(const UsualUnit&) = delete;
  UsualUnit& operator=(const UsualUnit&) = delete;
  ~UsualUnit() = default;

  [[nodiscard]] const MeshView& mesh() const { return mesh_; }
  [[nodiscard]] const BoundingBox& box() const { return box_; }
  /// Converts a length of the file to this unit; finite lengths stay finite.
  [[nodiscard]] double from_file(double length) const;
  [[nodiscard]] double to_file(double length) const { return length * unit_; }
  void to_file(Vertices& vertices) const {
    if (unit_ != 1.0) vertices *= unit_;
  }

 private:
  MeshView mesh_;
  BoundingBox box_;
  Vertices vertices_;  // empty: those of the input
  double unit_ = 1.0;
};

}  // namespace manip3d
