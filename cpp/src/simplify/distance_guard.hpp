#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/patch_distance.hpp"

namespace manip3d {

/// Keeps the two-sided Hausdorff distance between a mesh and its simplification below a limit, for
/// any simplifier that asks for permission before each change.
///
/// Two proofs are maintained. (1) Every original face is *hosted* by faces of the simplified mesh
/// near which it provably lies. A change must prove this again for the guests of the changed faces,
/// with their other hosts and the changed faces. (2) Every simplified face has a bound of its
/// distance from the original surface. It follows from the bounds of the faces that it replaces or,
/// once these have added up to the limit, from the original faces. The first proof includes
/// boundaries, because a rim that moves inwards leaves original faces behind.
///
/// With limit 0, a change must not change the surface as a set of points; this is decided by exact
/// predicates. Faces with a repeated vertex have no surface. A change within the limit may be
/// refused if the proof would need more than the nearby faces.
class DistanceGuard {
 public:
  /// @param limit     >= 0, in the mesh's units.
  /// @param on_proof  Called before each proof; a change may need many proofs.
  DistanceGuard(const MeshView& original, double limit, std::function<void()> on_proof = {});

  /// A face that remains after a change, with its new corners, in the mesh's units.
  struct Change {
    std::int32_t face;
    Triangle3 corners;
  };

  /// Whether a change keeps the limit; if so, commit() makes it.
  /// @param touched  Faces that move or are removed.
  /// @param changed  Touched faces that remain.
  /// @param around   Other faces nearby, which may help the proof.
  bool allows(std::span<const std::int32_t> touched, std::span<const Change> changed,
              std::span<const std::int32_t> around);
  void commit();

  /// Upper bound of the Hausdorff distance after the changes made, in the mesh's units.
  [[nodiscard]] double bound() const;

 private:
  struct Proof {
    std::int32_t original;
    double bound;
    std::vector<std::int32_t> hosts;
  };

  [[nodiscard]] Triangle3 to_unit(const Triangle3& corners) const;
  bool keeps_points(std::span<const std::int32_t> touched, std::span<const Change> changed) const;
  void gather_guests(std::span<const std::int32_t> touched);
  bool prove_changed(std::span<const std::int32_t> touched, std::span<const std::int32_t> around);
  bool prove_guests(std::span<const std::int32_t> around);
  bool prove_guest(std::int32_t original, std::span<const std::int32_t> others);

  std::function<void()> on_proof_;
  double limit_;  // in the unit of the coordinates below, minus the margin for rounding
  double margin_ = 0.0;
  double unit_ = 1.0;  // of the coordinates below, in the mesh's units
  Eigen::Vector3d center_ = Eigen::Vector3d::Zero();
  bool is_exact_ = false;
  bool is_changed_ = false;
  std::vector<Triangle3> original_;
  std::vector<PatchTriangle> current_;  // of the simplified mesh, by face of the original
  std::vector<std::vector<std::int32_t>> guests_;  // by face; may include former guests
  std::vector<std::vector<std::int32_t>> hosts_;   // by original face
  std::vector<double> bounds_;                     // by original face from its hosts

  // The change that allows() is proving.
  std::vector<std::int32_t> touched_;
  std::vector<Change> changed_;
  std::vector<double> errors_;  // bounds of changed_
  std::vector<Proof> proofs_;   // new proofs of the guests
  std::vector<std::int32_t> affected_;
  std::vector<bool> is_touched_, is_affected_;
  std::vector<PatchTriangle> patch_;
  std::vector<std::int32_t> patch_faces_;
  PatchDistance distance_;
};

}  // namespace manip3d
