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

/// Tracks the trunk of one person, and with it the plane of symmetry, from frame to frame.
///
/// Joints jitter by centimetres, the surface of the trunk by millimetres. The motion of the trunk
/// is therefore estimated from its surface: points of a key frame (KeySurface) are fitted to the
/// depth image by point-to-plane distances [Chen & Medioni, "Object modelling by registration of
/// multiple range images", 1992] with projective association [Blais & Levine, 1995]. The place of
/// the plane within the trunk follows from the joints (TrunkJoints) and from the surface, which is
/// fitted to its own mirror image (SymmetryPlane). Motion and joints are one least-squares estimate
/// with a constant-velocity prior. Residuals of surface and joints have the weights of heavy-tailed
/// distributions (Geman-McClure, Cauchy), so that an arm in front of the trunk or a joint that
/// jumps has little influence. `update` and `learn` allocate nothing after the first frame.
///
/// The chest may turn relative to the pelvis, to which the legs belong (Pelvis). If the body turns
/// as a whole, this turn stays 0 and the tracking is not delayed. A trunk with a turned pelvis is
/// twisted, by less the higher up in the loins. How far a person was twisted in the first frame is
/// unknown.
///
/// Errors of joints are lengths and do not scale with the body, so they turn the axes of a small
/// body by more than those of an adult: the errors of angles that follow from joints are divided by
/// the size of the trunk relative to an adult's.
///
/// The uncertainty of the trunk's motion grows with the time between two frames. After a gap of a
/// quarter of a second, in the images or only in the joints, the trunk starts again from the
/// joints. If the plane is turned relative to the shoulders and hips of the last tenth of a second
/// by more than their errors (AcrossCheck), or if the hips contradict the pelvis's turn (HipCheck),
/// the angle is added to its deviation; after 0.3 seconds the trunk is set to the joints. If all
/// joints jump by a common rotation from one frame to the next, the surface is searched for after
/// this rotation. They must keep their places within the trunk, because a skeleton that collapses
/// shows no rotation.
///
/// Joints are far if most of them are 15 cm from their places, or if all of them leapt aside and
/// have not come back: the surface of a trunk hardly resists a move along itself, so that the trunk
/// would follow them. Far joints are not believed; after 0.3 seconds the trunk starts again at
/// them, and their offset from the points around them, which was that of other joints, is 0.
class TrunkTracker {
 public:
  explicit TrunkTracker(Limb affected) : affected_(affected), pelvis_(affected) {}

  /// Sets the vertical, as a unit vector; default: along the image's columns.
  /// @param covariance  Covariance of `down`, square radians; the plane of a leg is at least as
  ///                    uncertain.
  void set_down(const Eigen::Vector3d& down,
                const Eigen::Matrix3d& covariance = Eigen::Matrix3d::Zero()) {
    down_ = down;
    down_covariance_ = covariance;
  }

  /// Sets the offset of the limbs' points from their joints, metres; default: 0.
  void set_offset(const Eigen::Vector3d& offset) { offset_ = offset; }

  /// Updates the trunk with a new frame.
  /// @param joints  Unfiltered; null: none, so that only the surface is tracked.
  /// @return  The axes of the body; no value before the first frame with usable joints.
  std::optional<BodyFrame> update(const Skeleton* joints, const DepthView& depth,
                                  const PixelRays& rays, const Intrinsics& camera, double time_s);

  /// Replaces the key frame if it no longer fits.
  /// @param points  Labelled points of the person in the frame of the last update.
  void learn(const PersonPoints& points, const DepthView& depth, const PixelRays& rays,
             const Intrinsics& camera);

  /// The current axes, which learn() may have changed.
  [[nodiscard]] std::optional<BodyFrame> frame() const;

  void reset();

  /// Whether most joints of the last frame are far from where the trunk has them: the trunk is not
  /// fitted to them, and how far they lie from the points around them says nothing of other frames.
  [[nodiscard]] bool has_far_joints() const { return are_far_; }
  /// Whether the trunk started again in the last frame, because its joints stay at other places.
  /// Their offset from the points around them is unknown then.
  [[nodiscard]] bool has_moved() const { return have_moved_; }

  /// Standard deviation of the plane's normal, degrees: of its roll and yaw within the trunk and of
  /// the trunk's own rotation, plus the turn of the plane relative to the joints or, for a leg, the
  /// twist of the chest relative to the hips. Infinite before the first frame.
  [[nodiscard]] double deviation_deg() const;
  /// Standard deviation of a point's distance from the plane, metres, due to errors of the plane.
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
  void look_for_far_joints(const Skeleton& joints, double elapsed);
  [[nodiscard]] bool contradicts() const;
  [[nodiscard]] bool has_jumped(const Skeleton& joints, double elapsed) const;
  [[nodiscard]] double offset_along(const Eigen::Vector3d& n) const;

  Limb affected_;
  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  Eigen::Matrix3d down_covariance_ = Eigen::Matrix3d::Zero();
  /// Metres, from the joints of the limbs to the middle of the points around them.
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();
  std::optional<TrunkPose> pose_;
  Vector6 velocity_ = Vector6::Zero();  ///< Rotation vector and translation, per second.
  double turn_variance_ = 0.0;          ///< Variance of the orientation, square radians.
  double time_s_ = 0.0, joints_time_s_ = 0.0, contradicted_since_ = 0.0;
  bool is_contradicted_ = false;
  bool have_leapt_ = false;  ///< All joints leapt aside and have not come back.
  bool are_far_ = false;     ///< Most joints of the last frame are far from where they were.
  bool have_moved_ = false;  ///< The trunk started again at such joints in the last frame.
  TrunkJoints joints_;
  KeySurface surface_;
  Pelvis pelvis_;
  SymmetryPlane plane_;
  AcrossCheck across_;
  HipCheck hips_;
};

}  // namespace manip3d
