#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/modify/mirror.hpp"
#include "modify/key_surface.hpp"
#include "modify/trunk_pose.hpp"

namespace manip3d {

/// The plane about which the surface of a trunk is its own mirror image, a mean over frames.
///
/// The mirrored points of the key frame are laid onto the depth image: the plane that fits best,
/// with that of the joints as a prior.
class SymmetryPlane {
 public:
  /// The plane as the joints of a frame tell it.
  struct Prior {
    BodyFrame axes;
    Eigen::Vector3d variance;  ///< Roll and yaw, square radians; aside, square metres.
    double aside = 0.0;        ///< Metres along its normal that the flesh lies beside the joints.
  };

  void measure(const Prior& prior, const KeySurface& surface, const TrunkPose& pose,
               double pelvis_turn, const SeenDepth& seen);

  [[nodiscard]] bool is_measured() const { return frames_ > 0.0; }
  /// The axes of the joints, turned and moved to the plane. `pose` is that of the trunk's end.
  [[nodiscard]] BodyFrame move(const BodyFrame& axes, const TrunkPose& pose) const;
  /// Covariance of the plane's place within the trunk: roll and yaw of its normal, radians, and its
  /// offset, metres. None until a frame told it.
  [[nodiscard]] const std::optional<Eigen::Matrix3d>& covariance() const { return covariance_; }
  void forget_covariance() { covariance_.reset(); }

  void reset() { *this = {}; }

 private:
  Eigen::Vector3d normal_ = Eigen::Vector3d::Zero();  ///< In the trunk.
  double offset_ = 0.0, frames_ = 0.0;
  std::optional<Eigen::Matrix3d> covariance_;
};

}  // namespace manip3d
