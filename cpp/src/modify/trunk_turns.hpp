#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/mirror.hpp"
#include "modify/trunk_joints.hpp"
#include "modify/trunk_pose.hpp"

/// @file
/// Checks whether the plane is turned about the spine relative to the joints of the last frames.
namespace manip3d {

/// A trunk with the turn of its pelvis relative to it.
struct TwistedPose {
  TrunkPose trunk;
  double pelvis_turn = 0.0;  ///< Radians.
};

/// Compares shoulders and hips with the normal of the plane.
class AcrossCheck {
 public:
  /// Whether the direction across has jumped relative to that of the last frames, predicted with
  /// the trunk's motion. The body may then have turned too far for its surface to be found from the
  /// last pose.
  /// @param foreseen  Rotation of the trunk predicted from its velocity.
  [[nodiscard]] bool has_jumped(const Skeleton& joints, const TrunkJoints& means,
                                const TwistedPose& pose, const Eigen::Quaterniond& foreseen) const;
  /// Measure how far a plane with these axes is turned about the spine relative to the shoulders
  /// and hips that were tracked recently. They are averaged in coordinates of the trunk, so that
  /// the mean does not lag behind a body that turns.
  void compare(const Skeleton& joints, const TrunkJoints& means, const TwistedPose& pose,
               const std::optional<BodyFrame>& axes, double elapsed);
  /// Forgets the direction, because one from before a turn is useless.
  void forget_direction() { across_.setZero(); }

  /// Angle between the two, radians, if it exceeds their errors; else 0.
  [[nodiscard]] double disagreement() const { return disagreement_; }

  void reset() { *this = {}; }

 private:
  /// Recent direction from right to left, in the trunk.
  Eigen::Vector3d across_ = Eigen::Vector3d::Zero();
  double disagreement_ = 0.0;
};

/// Compares the hips with the plane of a leg, relative to their usual angle. It measures the part
/// of a twist that Pelvis did not find.
class HipCheck {
 public:
  HipCheck() { reset(); }

  /// @param end          Pose of the end of the trunk to which the limb belongs.
  /// @param pelvis_turn  Turn of the pelvis in this pose, radians.
  void compare(const Skeleton& joints, const TrunkJoints& means, const TrunkPose& end,
               double pelvis_turn, const std::optional<BodyFrame>& axes, double elapsed);

  /// Angle of the hips from their usual angle, or from the plane if is_against_turn(), radians, if
  /// it exceeds their errors; else 0.
  [[nodiscard]] double twist() const { return twist_; }

  /// Whether the pelvis's turn is wrong: the hips are far from the plane, and would be nearer to it
  /// without the turn.
  [[nodiscard]] bool is_against_turn() const { return is_against_turn_; }

  void reset();

 private:
  Eigen::Vector3d hips_;  ///< Recent direction from right to left, in the trunk.
  /// Usual angle of the hips about the spine to the plane's normal, radians, and the seconds over
  /// which it was averaged.
  double usual_angle_, usual_time_;
  double twist_;
  bool is_against_turn_;
};

}  // namespace manip3d
