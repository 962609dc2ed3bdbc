#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/modify/mirror.hpp"
#include "modify/key_surface.hpp"
#include "modify/trunk_pose.hpp"

namespace manip3d {

/// The plane at which the surface of a trunk is its own mirror image, averaged over frames.
///
/// The mirrored points of the key frame are fitted to the depth image. The result is the plane with
/// the best fit; the plane of the joints is the prior.
class SymmetryPlane {
 public:
  /// The plane according to the joints of a frame.
  struct Prior {
    BodyFrame axes;
    Eigen::Vector3d variance;  ///< Roll and yaw, square radians; offset, square metres.
    /// Metres along its normal from the joints to the middle of the points around them.
    double aside = 0.0;
  };

  void measure(const Prior& prior, const KeySurface& surface, const TrunkPose& pose,
               double pelvis_turn, const SeenDepth& seen);

  [[nodiscard]] bool is_measured() const { return frames_ > 0.0; }
  /// Return the axes of the joints, turned and moved to the plane. `pose` is the pose of the end of
  /// the trunk (chest or pelvis) to which the limb belongs.
  [[nodiscard]] BodyFrame move(const BodyFrame& axes, const TrunkPose& pose) const;
  /// Covariance of the plane's place within the trunk: roll and yaw of its normal (square radians)
  /// and its offset (square metres). No value before the first frame.
  [[nodiscard]] const std::optional<Eigen::Matrix3d>& covariance() const { return covariance_; }
  void forget_covariance() { covariance_.reset(); }

  void reset() { *this = {}; }

 private:
  Eigen::Vector3d normal_ = Eigen::Vector3d::Zero();  ///< In coordinates of the trunk.
  double offset_ = 0.0, frames_ = 0.0;
  std::optional<Eigen::Matrix3d> covariance_;
};

}  // namespace manip3d
