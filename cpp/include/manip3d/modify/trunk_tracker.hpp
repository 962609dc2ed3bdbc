#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

class PixelProjector;

/// The axes of a body from all usable joints of its trunk: y along the line through the middle
/// ones, x the mean of the directions from right to left (shoulders count most for arms, hips for
/// legs), n = x made square to y, for legs with most of its sideways tilt against the vertical
/// taken out. The origin is at the height of SpineMid for arms, of SpineBase for legs. A
/// shoulder or hip that is missing is replaced by the middle of the spine there.
///
/// None with fewer than two joints in the middle or no pair, or axes as in body_frame().
/// @param down  unit vector: a camera may be tilted.
std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb,
                                     const Eigen::Vector3d& down = Eigen::Vector3d::UnitY());

/// Follows the trunk of one person, and with it the plane of symmetry, from frame to frame.
///
/// Joints shake by centimetres, the surface of the trunk by millimetres. The motion of the trunk is
/// therefore that of its surface: points of a key frame are laid onto the depth image, point to
/// plane [Chen & Medioni, "Object modelling by registration of multiple range images", 1992], with
/// projective association [Blais & Levine, 1995]. The joints say where the plane lies within the
/// trunk: each one's place there is a mean over its last 3 seconds; and so does the surface, which
/// is laid onto its own mirror image. Motion and joints are one least-squares
/// estimate with a prior from constant velocity; residuals of surface and joints are weighted as
/// those of heavy-tailed distributions (Geman-McClure, Cauchy), so that an arm before the trunk or
/// a joint that jumps does not count. `update` and `learn` allocate nothing after the first frame.
///
/// A chest turns against the pelvis, which bears the legs. Once the trunk is followed as if it were
/// rigid, the pelvis is laid onto its own surface and joints: a body that turns as a whole leaves
/// nothing to tell there, and is not followed later than without. A turn counts beyond three
/// deviations and 3 degrees, and wholly from twice as much on. The trunk is then turned in itself,
/// by less the farther up the loins. How far a person was turned at the start is not known.
///
/// Joints are off by metres, and so turn the axes of a small body by more than those of an adult:
/// the angles that they are trusted to are divided by the trunk's size against an adult's.
///
/// The uncertainty of the trunk's motion grows with the time between two frames. After a gap
/// of a quarter of a second, in the images or in the joints alone, the joints tell the trunk anew.
/// If the plane is turned against the shoulders and hips of the last tenth of a second by more than
/// they err, the turn is part of its deviation, and after 0.3 seconds the joints are believed.
/// Joints that jump by a turn from one frame to the next say where the surface is looked for, if
/// they lie as they lie in the trunk: a skeleton that collapses tells no turn.
class TrunkTracker {
 public:
  explicit TrunkTracker(Limb affected);

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
  struct Pose {  ///< Trunk to camera.
    Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
    Eigen::Vector3d translation = Eigen::Vector3d::Zero();
    [[nodiscard]] Eigen::Vector3d operator()(const Eigen::Vector3d& p) const {
      return rotation * p + translation;
    }
  };
  struct SurfacePoint {
    Eigen::Vector3d place, normal;  ///< In the trunk, not twisted.
    double share = 0.0;             ///< Part that it has in the pelvis's turn.
  };
  struct JointMean {
    std::array<Eigen::Vector3d, 2> last;  ///< In the camera, the latest one first.
    int num_last = 0;
    Eigen::Vector3d place = Eigen::Vector3d::Zero();  ///< In the trunk.
    double weight = 0.0;                              ///< Frames, at most those of the window.
    double jitter = 0.0;  ///< Variance of its white noise, square metres; 0: never seen.
    Eigen::Vector3d last_error = Eigen::Vector3d::Zero();  ///< From its mean, in the trunk.
  };
  struct Knee {  ///< The intact leg's, while it is on a seat; in the pelvis.
    Eigen::Vector3d place = Eigen::Vector3d::Zero();
    double weight = 0.0;  ///< Frames, at most those of the window.
  };
  struct Across {  ///< In the camera.
    Eigen::Vector3d direction = Eigen::Vector3d::Zero();
    double jitter = 0.0;  ///< Standard deviation of the direction in one frame, radians.
  };
  struct PlaneMean {  ///< In the trunk.
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    double offset = 0.0, weight = 0.0;
  };
  using JointTrust = std::array<double, kNumJoints>;  ///< Against one that is exact.
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  struct NormalEquations {  ///< For a small turn and move of the pose.
    Matrix6 information = Matrix6::Zero();
    Vector6 gradient = Vector6::Zero();
  };
  struct PelvisEquations {  ///< For a small turn of the pelvis about the spine, and a move.
    Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
    Eigen::Vector4d gradient = Eigen::Vector4d::Zero();
    void add(const Eigen::Vector4d& row, double off, double weight) {
      information += weight * row * row.transpose();
      gradient += weight * off * row;
    }
  };
  struct PelvisTurn {  ///< Against the trunk, about the spine, radians.
    double told = 0.0, variance = 0.0;
    double turn = 0.0;  ///< The part that is believed: 0 until it is beyond its errors.
  };
  struct Agreement {  ///< Between the key frame and the surface that is seen.
    std::size_t points = 0;
    double off = 0.0;  ///< Sum of their distances, metres.
  };

  void start(const BodyFrame& frame);
  void follow(const Skeleton* joints, const DepthView& depth, const PixelRays& rays,
              const Intrinsics& camera, double elapsed, bool jumps);
  void end_motion();
  void fit(const Skeleton* joints, const DepthView& depth, const PixelRays& rays,
           const Intrinsics& camera, double elapsed);
  [[nodiscard]] static NormalEquations motion_prior(const Vector6& moved, double frames);
  Agreement add_surface(const DepthView& depth, const PixelRays& rays,
                        const PixelProjector& projector, NormalEquations& equations) const;
  void add_joints(const Skeleton& joints, double scale, NormalEquations& equations) const;
  void follow_pelvis(const Skeleton* joints, const DepthView& depth, const PixelRays& rays,
                     const Intrinsics& camera, double elapsed);
  void add_pelvis_surface(const Eigen::Vector3d& moved, const DepthView& depth,
                          const PixelRays& rays, const PixelProjector& projector,
                          PelvisEquations& equations) const;
  void add_pelvis_joints(const Eigen::Vector3d& moved, const Skeleton& joints,
                         PelvisEquations& equations) const;
  [[nodiscard]] std::optional<Eigen::Vector3d> lap(const Skeleton& joints) const;
  [[nodiscard]] Pose end_of_limb() const;
  [[nodiscard]] Eigen::Vector3d place_of(Joint joint, double pelvis_turn) const;
  [[nodiscard]] std::optional<BodyFrame> frame_at(const Pose& pose) const;
  void measure_jitter(const Skeleton& joints);
  void average_joints(const Skeleton& joints);
  [[nodiscard]] bool contradicts(const Skeleton& joints) const;
  void compare_turn(const Skeleton& joints, double elapsed);
  void compare_hips(const Skeleton& joints, double elapsed);
  [[nodiscard]] std::optional<Across> tracked_across(const Skeleton& joints) const;
  [[nodiscard]] bool has_jumped(const Skeleton& joints, double elapsed) const;
  [[nodiscard]] double off_as_a_whole(const Skeleton& joints) const;
  [[nodiscard]] Skeleton mean_skeleton(const Pose& pose) const;
  void measure_symmetry(const DepthView& depth, const PixelRays& rays, const Intrinsics& camera);
  [[nodiscard]] double correlation() const;
  [[nodiscard]] double innovation(const JointMean& mean) const;
  [[nodiscard]] double mean_variance(const JointMean& mean) const;
  [[nodiscard]] JointTrust joint_trust() const;
  [[nodiscard]] double offset_along(const Eigen::Vector3d& n) const;
  [[nodiscard]] double size_against_adult() const;
  [[nodiscard]] double level_variance(const Eigen::Vector3d& n) const;
  [[nodiscard]] Eigen::Vector3d joint_plane_variance(const Eigen::Vector3d& n) const;

  Limb affected_;
  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  Eigen::Matrix3d down_covariance_ = Eigen::Matrix3d::Zero();
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();  ///< Metres, limbs' flesh from joints.
  std::optional<Pose> pose_;
  Vector6 velocity_ = Vector6::Zero();  ///< Rotation vector and translation, per second.
  double time_s_ = 0.0, joints_time_s_ = 0.0, contradicted_since_ = 0.0;
  bool is_contradicted_ = false;
  std::array<JointMean, kNumJoints> joints_{};
  PlaneMean plane_;
  Eigen::Vector3d across_ = Eigen::Vector3d::Zero();  ///< From right to left lately, in the trunk.
  double disagreement_ = 0.0;  ///< Radians between it and the plane's normal, if beyond its errors.
  /// The hips against the plane of a leg: from right to left lately, in the trunk; the angle about
  /// the spine that they usually have to the plane's normal, radians, and the seconds that tell it.
  Eigen::Vector3d hips_ = Eigen::Vector3d::Zero();
  double usual_angle_ = 0.0, usual_time_ = 0.0;
  double twist_ = 0.0;  ///< Radians that they are turned from that, if beyond their errors.
  PelvisTurn pelvis_;
  Knee knee_;
  std::vector<SurfacePoint> surface_;
  Eigen::Quaterniond key_rotation_ = Eigen::Quaterniond::Identity();
  double residual_ = 0.0;  ///< Mean distance of the surface from the key frame, metres.
  /// Running sums over the joints: the squared error, and the product of the errors of a frame and
  /// the next one. Their ratio is the correlation from frame to frame.
  double error_power_ = 0.0, error_product_ = 0.0;
  double turn_variance_ = 0.0;  ///< Variance of the trunk's orientation, square radians.
  /// Covariance of the plane's place within the trunk: roll and yaw of its normal, radians, and its
  /// offset, metres. None until a frame told it.
  std::optional<Eigen::Matrix3d> covariance_;
  double surface_share_ = 0.0;  ///< Share of the key frame that the last frame agreed with.
};

}  // namespace manip3d
