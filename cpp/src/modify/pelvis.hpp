#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/key_surface.hpp"
#include "modify/trunk_joints.hpp"
#include "modify/trunk_pose.hpp"

namespace manip3d {

/// The turn about the spine of the pelvis relative to the trunk above it, of a person without a
/// leg.
///
/// The trunk is tracked as if it were rigid. Then the pelvis is fitted to its own surface and
/// joints; on a seat, the thigh turns with it. Only the angle is carried over from frame to frame.
/// The translation is estimated in each frame, because a front that turns looks much like one that
/// moves sideways: if the trunk was turned together with the chest, a translation absorbs the
/// error, which would otherwise hide the turn. A turn is used only above three standard deviations
/// and 3 degrees, and fully from twice as much on.
class Pelvis {
 public:
  explicit Pelvis(Limb affected) : affected_(affected) {}

  /// Updates the turn with the next frame, in which the trunk has the pose `pose`.
  /// @param joints   Null: there are none.
  /// @param elapsed  Time since the last frame, seconds.
  void follow(const Skeleton* joints, const SeenDepth& seen, const KeySurface& surface,
              const TrunkJoints& means, const TrunkPose& pose, double elapsed);
  /// Updates the mean of the intact knee, if the person is on a seat.
  void learn_knee(const Skeleton& joints, const TrunkPose& pose);

  /// Radians; 0 for arms, and until the turn exceeds its errors.
  [[nodiscard]] double turn() const { return turn_; }
  /// Return the pose of the end of the trunk to which the limb belongs.
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
  /// Radians: estimate, its variance, and the part of it that is used.
  double estimated_turn_ = 0.0, variance_ = 0.0, turn_ = 0.0;
  /// In coordinates of the pelvis, while the person is on a seat.
  Eigen::Vector3d knee_ = Eigen::Vector3d::Zero();
  double knee_frames_ = 0.0;
};

}  // namespace manip3d
