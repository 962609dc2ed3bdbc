#pragma once

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// A mesh scaled by a power of two where its diagonal is outside of 2^-200 to 2^200, else as it is,
/// so that no product of some lengths overflows or vanishes. Such a factor rounds nothing: the
/// result is the one at another scale to the last bit.
class UsualUnit {
 public:
  /// @param mesh  Outlives this.
  /// @throws InputError  the diagonal of its bounding box is not a finite number.
  explicit UsualUnit(const MeshView& mesh);
  UsualUnit(const UsualUnit&) = delete;
  UsualUnit& operator=(const UsualUnit&) = delete;
  ~UsualUnit() = default;

  [[nodiscard]] const MeshView& mesh() const { return mesh_; }
  [[nodiscard]] const BoundingBox& box() const { return box_; }
  /// A length of the file in this unit; what is finite stays so.
  [[nodiscard]] double from_file(double length) const;
  [[nodiscard]] double to_file(double length) const { return length * unit_; }
  void to_file(Vertices& vertices) const {
    if (unit_ != 1.0) vertices *= unit_;
  }

 private:
  MeshView mesh_;
  BoundingBox box_;
  Vertices vertices_;  // empty: those of the file
  double unit_ = 1.0;
};

}  // namespace manip3d
