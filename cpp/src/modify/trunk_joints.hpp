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
/// Places of the joints within a trunk, and how well they are known.
namespace manip3d {

inline constexpr double kJointBias = 0.02;  ///< Metres of a joint's mean that never average out.
/// Metres that joints are off by until a Cauchy weight halves.
inline constexpr double kJointScale = 0.05;
/// The weight of a joint with errors of that variance that lies so far off.
double joint_weight(double variance, double squared_off, double scale = kJointScale);

/// Means of the joints of one trunk over the last 3 seconds, and the errors of a frame's joints.
class TrunkJoints {
 public:
  TrunkJoints() { reset(); }
  void reset();
  /// Forgets all but what the tracker's errors are like.
  void forget_places();
  /// The next frame does not follow the last one.
  void end_motion();

  /// Measures the variance of white noise that would make each joint's second differences.
  void measure_jitter(const Skeleton& joints);
  /// Takes the joints of a frame into their means in the trunk, and measures the correlation of
  /// their errors from frame to frame.
  void average(const Skeleton& joints, const TrunkPose& pose, double pelvis_turn);

  [[nodiscard]] bool is_known(Joint joint) const { return of(joint).weight > 0.0; }
  /// A joint's mean place in the trunk whose pelvis is turned.
  [[nodiscard]] Eigen::Vector3d place(Joint joint, double pelvis_turn) const {
    return with_pelvis(of(joint).place, joint, pelvis_turn);
  }
  /// From its mean, in the trunk, in the last frame.
  [[nodiscard]] const Eigen::Vector3d& last_error(Joint joint) const {
    return of(joint).last_error;
  }
  /// The means where the trunk is now.
  [[nodiscard]] Skeleton skeleton(const TrunkPose& pose) const;
  [[nodiscard]] KeySurface::Extent extent() const;

  /// Variance of a joint's white noise, square metres; 0: never seen.
  [[nodiscard]] double jitter(Joint joint) const { return of(joint).jitter; }
  /// Correlation of the joints' errors from one frame to the next.
  [[nodiscard]] double correlation() const;
  /// Variance of what is new in a joint's error from frame to frame.
  [[nodiscard]] double innovation(Joint joint) const;
  /// Trust of each joint's mean: the variance that an exact mean has in any case over that of this
  /// one; 0 for a joint never seen.
  [[nodiscard]] JointTrust trust() const;

  /// How large the trunk is against an adult's, by its shoulders and its spine; 1 for larger ones,
  /// and as long as neither is known.
  [[nodiscard]] double size_against_adult() const;
  /// Variances of the plane with a normal that the joints tell: its roll and yaw, and metres aside.
  /// @param down_covariance  of the vertical, by which a plane for legs is levelled.
  [[nodiscard]] Eigen::Vector3d plane_variance(const Eigen::Vector3d& n, Limb limb,
                                               const Eigen::Matrix3d& down_covariance) const;

  /// Are most joints of a frame far from where they are in the trunk?
  [[nodiscard]] bool are_far(const Skeleton& joints, const TrunkPose& pose,
                             double pelvis_turn) const;
  /// Mean distance of the tracked joints from where they are in the trunk, metres, once the trunk
  /// is laid onto them [Kabsch, "A solution for the best rotation to relate two sets of vectors",
  /// 1976].
  [[nodiscard]] double off_as_a_whole(const Skeleton& joints, double pelvis_turn) const;

 private:
  struct Mean {
    /// In the camera, the latest one first.
    std::array<Eigen::Vector3d, 2> last{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    int num_last = 0;
    Eigen::Vector3d place = Eigen::Vector3d::Zero();  ///< In the trunk.
    double weight = 0.0;                              ///< Frames, at most those of the window.
    double jitter = 0.0;
    Eigen::Vector3d last_error = Eigen::Vector3d::Zero();
  };
  [[nodiscard]] const Mean& of(Joint joint) const {
    return means_[static_cast<std::size_t>(joint)];
  }
  [[nodiscard]] Mean& of(Joint joint) { return means_[static_cast<std::size_t>(joint)]; }
  [[nodiscard]] double mean_variance(Joint joint) const;

  std::array<Mean, kNumJoints> means_{};
  /// Running sums over the joints: the squared error, and the product of the errors of a frame and
  /// the next one. Their ratio is the correlation from frame to frame.
  double error_power_ = 0.0, error_product_ = 0.0;
};

}  // namespace manip3d
