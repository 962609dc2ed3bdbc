#pragma once

#include <Eigen/Core>
#include <optional>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/key_surface.hpp"
#include "modify/pelvis.hpp"
#include "modify/symmetry_plane.hpp"
#include "modify/trunk_joints.hpp"
#include "modify/trunk_pose.hpp"
#include "modify/trunk_turns.hpp"

namespace manip3d {

/// Follows the trunk of one person, and with it the plane of symmetry, from frame to frame.
///
/// Joints shake by centimetres, the surface of the trunk by millimetres. The motion of the trunk is
/// therefore that of its surface: points of a key frame (KeySurface) are laid onto the depth image,
/// point to plane [Chen & Medioni, "Object modelling by registration of multiple range images",
/// 1992], with projective association [Blais & Levine, 1995]. The joints say where the plane lies
/// within the trunk (TrunkJoints), and so does the surface, which is laid onto its own mirror image
/// (SymmetryPlane). Motion and joints are one least-squares estimate with a prior from constant
/// velocity; residuals of surface and joints are weighted as those of heavy-tailed distributions
/// (Geman-McClure, Cauchy), so that an arm before the trunk or a joint that jumps does not count.
/// `update` and `learn` allocate nothing after the first frame.
///
/// A chest turns against the pelvis, which bears the legs (Pelvis): a body that turns as a whole
/// leaves nothing to tell there, and is not followed later than without. The trunk is then turned
/// in itself, by less the farther up the loins. How far a person was turned at the start is not
/// known.
///
/// Joints are off by metres, and so turn the axes of a small body by more than those of an adult:
/// the angles that they are trusted to are divided by the trunk's size against an adult's.
///
/// The uncertainty of the trunk's motion grows with the time between two frames. After a gap
/// of a quarter of a second, in the images or in the joints alone, the joints tell the trunk anew.
/// If the plane is turned against the shoulders and hips of the last tenth of a second by more than
/// they err (AcrossCheck), the turn is part of its deviation, and after 0.3 seconds the joints are
/// believed. Joints that jump by a turn from one frame to the next say where the surface is looked
/// for, if they lie as they lie in the trunk: a skeleton that collapses tells no turn.
class TrunkTracker {
 public:
  explicit TrunkTracker(Limb affected) : affected_(affected), pelvis_(affected) {}

  /// Says which way is down from now on, as a unit vector: until then along the image's columns.
  /// @param covariance  of `down`, square radians: the plane of a leg is no surer than that.
  void set_down(const Eigen::Vector3d& down,
                const Eigen::Matrix3d& covariance = Eigen::Matrix3d::Zero()) {
    down_ = down;
    down_covariance_ = covariance;
  }

  /// Says how far the flesh of the limbs lies beside their joints from now on, metres: until then
  /// it does not.
  void set_offset(const Eigen::Vector3d& offset) { offset_ = offset; }

  /// The trunk in a new frame.
  /// @param joints  unfiltered; null while there are none: the surface alone is followed.
  /// @return  the axes of the body; none until the joints told them once.
  std::optional<BodyFrame> update(const Skeleton* joints, const DepthView& depth,
                                  const PixelRays& rays, const Intrinsics& camera, double time_s);

  /// Renews the key frame where the last one no longer fits.
  /// @param points  of the person, labelled, from the frame of the last update.
  void learn(const PersonPoints& points, const DepthView& depth, const PixelRays& rays,
             const Intrinsics& camera);

  /// The axes as known now: learning may have changed them.
  [[nodiscard]] std::optional<BodyFrame> frame() const;

  void reset();

  /// Standard deviation of the plane's normal, degrees, of its roll and yaw within the trunk and of
  /// the trunk's own turn, with what it is turned by against the joints, or, for a leg, what the
  /// chest is twisted by against the hips; infinite before the first frame.
  [[nodiscard]] double deviation_deg() const;
  /// Standard deviation of a point's distance from the plane, metres, by the plane's own errors.
  [[nodiscard]] double deviation_at(const Eigen::Vector3d& p, const BodyFrame& frame) const;

 private:
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  struct NormalEquations;

  void start(const BodyFrame& frame);
  void end_motion();
  void follow(const Skeleton* joints, const SeenDepth& seen, double elapsed, bool jumps);
  void fit(const Skeleton* joints, const SeenDepth& seen, double elapsed);
  KeySurface::Agreement add_surface(const SeenDepth& seen, NormalEquations& equations) const;
  void add_joints(const Skeleton& joints, double scale, NormalEquations& equations) const;
  [[nodiscard]] std::optional<BodyFrame> joint_axes(const TrunkPose& pose) const;
  [[nodiscard]] std::optional<BodyFrame> frame_at(const TrunkPose& pose) const;
  void measure_symmetry(const SeenDepth& seen);
  [[nodiscard]] bool contradicts(const Skeleton& joints) const;
  [[nodiscard]] bool has_jumped(const Skeleton& joints, double elapsed) const;
  [[nodiscard]] double offset_along(const Eigen::Vector3d& n) const;

  Limb affected_;
  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  Eigen::Matrix3d down_covariance_ = Eigen::Matrix3d::Zero();
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();  ///< Metres, limbs' flesh from joints.
  std::optional<TrunkPose> pose_;
  Vector6 velocity_ = Vector6::Zero();  ///< Rotation vector and translation, per second.
  double turn_variance_ = 0.0;          ///< Variance of the orientation, square radians.
  double time_s_ = 0.0, joints_time_s_ = 0.0, contradicted_since_ = 0.0;
  bool is_contradicted_ = false;
  TrunkJoints joints_;
  KeySurface surface_;
  Pelvis pelvis_;
  SymmetryPlane plane_;
  AcrossCheck across_;
  HipCheck hips_;
};

}  // namespace manip3d
