#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/mirror.hpp"
#include "modify/trunk_joints.hpp"
#include "modify/trunk_pose.hpp"

/// @file
/// Is the plane turned about the spine against what the joints of the last frames say?
namespace manip3d {

/// A trunk, and the turn of its pelvis against it.
struct TwistedPose {
  TrunkPose trunk;
  double pelvis_turn = 0.0;  ///< Radians.
};

/// Shoulders and hips against the normal of the plane.
class AcrossCheck {
 public:
  /// Has the direction across jumped against that of the last frames, carried on with the trunk?
  /// Then the body may have turned farther than its surface is found from the last pose.
  /// @param foreseen  rotation of the trunk by its velocity.
  [[nodiscard]] bool has_jumped(const Skeleton& joints, const TrunkJoints& means,
                                const TwistedPose& pose, const Eigen::Quaterniond& foreseen) const;
  /// How far a plane with these axes is turned about the spine against the shoulders and hips that
  /// were tracked lately. They are averaged within the trunk, so that a body that turns is not
  /// behind.
  void compare(const Skeleton& joints, const TrunkJoints& means, const TwistedPose& pose,
               const std::optional<BodyFrame>& axes, double elapsed);
  /// Forgets the direction: the one from before a turn tells nothing.
  void forget_direction() { across_.setZero(); }

  /// Radians between the two, if that is beyond their errors; else 0.
  [[nodiscard]] double disagreement() const { return disagreement_; }

  void reset() { *this = {}; }

 private:
  Eigen::Vector3d across_ = Eigen::Vector3d::Zero();  ///< From right to left lately, in the trunk.
  double disagreement_ = 0.0;
};

/// The hips against the plane of a leg, from what they usually are: what of a twist the pelvis was
/// not seen to turn by.
class HipCheck {
 public:
  HipCheck() { reset(); }

  /// @param end  of the trunk, that bears the limb.
  void compare(const Skeleton& joints, const TrunkJoints& means, const TrunkPose& end,
               const std::optional<BodyFrame>& axes, double elapsed);

  /// Radians that the hips are turned from what they usually are, if that is beyond their errors;
  /// else 0.
  [[nodiscard]] double twist() const { return twist_; }

  void reset();

 private:
  Eigen::Vector3d hips_;  ///< From right to left lately, in the trunk.
  /// Radians about the spine that they usually have to the plane's normal, and the seconds that
  /// tell it.
  double usual_angle_, usual_time_;
  double twist_;
};

}  // namespace manip3d
