#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "modify/key_surface.hpp"
#include "modify/trunk_axes.hpp"
#include "modify/trunk_pose.hpp"

/// @file
/// Positions of the joints within a trunk, and how accurately they are known.
namespace manip3d {

/// Error of a joint's mean, metres, that does not average out.
inline constexpr double kJointBias = 0.02;
/// Distance of a joint, metres, at which its Cauchy weight is a half.
inline constexpr double kJointScale = 0.05;
/// Metres; joints that are off by as much belong to another pose.
inline constexpr double kContradiction = 0.15;
/// Weight of a joint with errors of this variance at this squared distance from its expected place.
double joint_weight(double variance, double squared_off, double scale = kJointScale);

/// Means of the joints of one trunk over the last 3 seconds, and the errors of a frame's joints.
class TrunkJoints {
 public:
  TrunkJoints() { reset(); }
  void reset();
  /// Forgets everything except the statistics of the tracker's errors.
  void forget_places();
  /// Marks that the next frame does not follow the last one.
  void end_motion();

  /// Estimates the variance of white noise that explains the second differences of each joint.
  void measure_jitter(const Skeleton& joints);
  /// Updates the means of the joints in the trunk with a frame, and the correlation of their errors
  /// from frame to frame.
  void average(const Skeleton& joints, const TrunkPose& pose, double pelvis_turn);

  [[nodiscard]] bool is_known(Joint joint) const { return of(joint).weight > 0.0; }
  /// Mean position of a joint in the trunk, with the pelvis turned.
  [[nodiscard]] Eigen::Vector3d place(Joint joint, double pelvis_turn) const {
    return with_pelvis(of(joint).place, joint, pelvis_turn);
  }
  /// Difference of the joint from its mean, in the trunk, in the last frame.
  [[nodiscard]] const Eigen::Vector3d& last_error(Joint joint) const {
    return of(joint).last_error;
  }
  /// The means at the current pose of the trunk.
  [[nodiscard]] Skeleton skeleton(const TrunkPose& pose) const;
  [[nodiscard]] KeySurface::Extent extent() const;

  /// Variance of a joint's white noise, square metres; 0: never seen.
  [[nodiscard]] double jitter(Joint joint) const { return of(joint).jitter; }
  /// Correlation of the joints' errors from one frame to the next.
  [[nodiscard]] double correlation() const;
  /// Variance of the new part of a joint's error in each frame, square metres.
  [[nodiscard]] double innovation(Joint joint) const;
  /// Trust in each joint's mean: the variance of an exact mean (kJointBias) divided by the variance
  /// of this one; 0 for a joint that was never seen.
  [[nodiscard]] JointTrust trust() const;

  /// Size of the trunk relative to an adult's, from shoulders and spine; at most 1, and 1 while
  /// both are unknown.
  [[nodiscard]] double size_against_adult() const;
  /// Variances of the plane with the normal n that follows from the joints: roll and yaw, square
  /// radians, and offset, square metres.
  /// @param down_covariance  Covariance of the vertical, at which a plane for legs is levelled.
  [[nodiscard]] Eigen::Vector3d plane_variance(const Eigen::Vector3d& n, Limb limb,
                                               const Eigen::Matrix3d& down_covariance) const;

  /// Mean step of the joints since the last frame, metres; 0 if none of them was usable in both.
  [[nodiscard]] Eigen::Vector3d mean_step(const Skeleton& joints) const;
  /// Whether most joints of a frame are farther from their expected places than a limit, metres.
  [[nodiscard]] bool are_far(const Skeleton& joints, const TrunkPose& pose, double pelvis_turn,
                             double limit = kContradiction) const;
  /// Mean distance of the tracked joints from their expected places, metres, after the best rigid
  /// alignment of the trunk [Kabsch, "A solution for the best rotation to relate two sets of
  /// vectors", 1976].
  [[nodiscard]] double off_as_a_whole(const Skeleton& joints, double pelvis_turn) const;

 private:
  struct Mean {
    /// In the camera frame, the latest first.
    std::array<Eigen::Vector3d, 2> last{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    int num_last = 0;
    Eigen::Vector3d place = Eigen::Vector3d::Zero();  ///< In coordinates of the trunk.
    double weight = 0.0;  ///< Number of frames, at most that of the window.
    double jitter = 0.0;
    Eigen::Vector3d last_error = Eigen::Vector3d::Zero();
  };
  [[nodiscard]] const Mean& of(Joint joint) const {
    return means_[static_cast<std::size_t>(joint)];
  }
  [[nodiscard]] Mean& of(Joint joint) { return means_[static_cast<std::size_t>(joint)]; }
  [[nodiscard]] double mean_variance(Joint joint) const;

  std::array<Mean, kNumJoints> means_{};
  /// Running sums over the joints of the squared error and of the product of the errors in
  /// consecutive frames. Their ratio is the correlation from frame to frame.
  double error_power_ = 0.0, error_product_ = 0.0;
};

}  // namespace manip3d
