#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/key_surface.hpp"
#include "modify/trunk_joints.hpp"
#include "modify/trunk_pose.hpp"

namespace manip3d {

/// The turn about the spine of a pelvis against the trunk above it, of a person without a leg.
///
/// Once the trunk is followed as if it were rigid, the pelvis is laid onto its own surface and
/// joints, and a thigh on a seat turns with it. Only the angle has a memory: what the pelvis has
/// moved by keeps a trunk that turned with the chest from hiding it, as a front that turns looks
/// much like one that moves aside. A turn counts beyond three deviations and 3 degrees, and wholly
/// from twice as much on.
class Pelvis {
 public:
  explicit Pelvis(Limb affected) : affected_(affected) {}

  /// One frame on, in which the trunk is where `pose` says.
  /// @param joints   null while there are none.
  /// @param elapsed  seconds.
  void follow(const Skeleton* joints, const SeenDepth& seen, const KeySurface& surface,
              const TrunkJoints& means, const TrunkPose& pose, double elapsed);
  /// Takes the intact knee of a person on a seat into its mean.
  void learn_knee(const Skeleton& joints, const TrunkPose& pose);

  /// Radians, as far as they are believed: 0 until the turn is beyond its errors, and for arms.
  [[nodiscard]] double turn() const { return turn_; }
  /// The end of the trunk that bears the limb.
  [[nodiscard]] TrunkPose end_of_limb(const TrunkPose& pose) const;

  void reset() { *this = Pelvis(affected_); }

 private:
  struct Equations;
  void add_surface(const Eigen::Vector3d& moved, const SeenDepth& seen, const KeySurface& surface,
                   const TrunkPose& pose, Equations& equations) const;
  void add_joints(const Eigen::Vector3d& moved, const Skeleton& joints, const TrunkJoints& means,
                  const TrunkPose& pose, Equations& equations) const;
  void add_knee(const Eigen::Vector3d& moved, const Skeleton& joints, const TrunkJoints& means,
                const TrunkPose& pose, Equations& equations) const;
  [[nodiscard]] std::optional<Eigen::Vector3d> lap(const Skeleton& joints,
                                                   const TrunkPose& pose) const;

  Limb affected_;
  double told_ = 0.0, variance_ = 0.0, turn_ = 0.0;  ///< Radians; `turn_` is what is believed.
  Eigen::Vector3d knee_ = Eigen::Vector3d::Zero();   ///< While it is on a seat, in the pelvis.
  double knee_frames_ = 0.0;
};

}  // namespace manip3d
