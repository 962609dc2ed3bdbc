#include "manip3d/modify/trunk_tracker.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <numbers>
#include <tuple>

#include "geometry/constants.hpp"
#include "geometry/small_solvers.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/phantom_image.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

using enum Joint;

constexpr std::size_t kMostSurface = 500;  // points of a key frame: more do not steady it
constexpr std::size_t kLeastSurface = 60;  // with fewer the joints alone are followed
constexpr int kIterations = 4;             // steps fall below 0.1 mm by the third
constexpr double kWindow = 90.0;           // frames over which joints are averaged
constexpr double kFirstErrors = 5.0;       // frames that the first correlation counts as
// Noise of a pixel's distance to a key frame, metres: four times the mean residual, at least 1 cm
// (a Kinect V1 steps by 2 cm). Four, because neighbours share their noise, so that 500 points tell
// as much as some thirty.
constexpr double kSurfaceNoise = 0.010, kSharedNoise = 4.0;
constexpr double kSurfaceScale = 0.02;  // metres: of the Geman-McClure weight
constexpr double kAgreement =
    1.7320508075688772 * kSurfaceScale;  // sqrt(3): there the weight is 1 / 16
// Bounds of the jitter that is measured for a joint of the trunk, metres. Errors below 1 cm change
// slowly, so that they are not seen as jitter, but they are there.
constexpr double kLeastJointNoise = 0.01, kMostJointNoise = 0.08;
constexpr double kFirstJitter = 0.005,
                 kGuessed = 5.0;     // metres, before it is measured; a guess: times
constexpr double kJointBias = 0.02;  // metres: error of a joint's mean that no averaging removes
// Errors of joints from frame to frame, until they are measured: trackers filter.
constexpr double kFirstCorrelation = 0.8, kMostCorrelation = 0.95;
constexpr double kJointScale = 0.05;  // metres: of the Cauchy weight
// Deviation of the trunk's offset from its joints, as a share of what that of the limbs says of it.
constexpr double kUnknownOffset = 0.5;
// Change of the trunk's motion in a frame: radians and metres of the Cauchy prior.
constexpr double kTurnNoise = 0.010, kMoveNoise = 0.006;
// The pelvis against the trunk: radians that it is usually turned by, and that this changes by in a
// frame; metres that it moves by aside; radians of a turn that is not believed, and deviations.
// Chosen on seed 5 of `bench_people.py --twist` and on seed 3 of `bench_steadiness.py`.
constexpr double kUsualTurn = 0.2, kTurnChange = 0.04, kPelvisMove = 0.03;
constexpr double kLeastTurn = 0.05, kSureTurn = 3.0;
// The loins, as parts of the way from the hips to the neck, are where the trunk turns in itself.
constexpr double kLowLoins = 0.2, kHighLoins = 0.7;
constexpr double kStepMemory = 0.7;      // share of the velocity that is kept from frame to frame
constexpr double kContradiction = 0.15;  // metres: joints off by so much are another trunk's
constexpr double kContradictionTime = 0.3;  // seconds until joints are believed
constexpr double kFrameTime = 1.0 / 30.0;   // seconds: of the priors
constexpr double kGap = 0.25;    // seconds without a frame after which the motion is unknown
constexpr double kMissed = 0.1;  // seconds after which the joints say where the surface is
// Seconds over which the joints' direction across is averaged, and radians that it may differ from
// the plane's normal by: a reaching arm takes its shoulder along by up to 10 cm.
constexpr double kAcrossTime = 0.1, kMostDisagreement = 0.26;
// Seconds over which the direction of the hips is averaged, and its usual angle to the plane;
// radians that it may differ by from that, beyond one and a half deviations of its errors; seconds
// that an angle of 0 counts as at the start. Chosen on seed 0 of `bench_people.py --twist` and on
// the tuning half of the recorded people.
constexpr double kHipsTime = 0.2, kUsualTime = 10.0, kMostTwist = 0.10, kFirstUsual = 3.0;
// Radians that the joints' direction across may jump by from one frame to the next, and standard
// deviations of its jitter: beyond both the body may have turned farther than its surface is found
// from the last pose.
constexpr double kMostJump = 0.21, kSureJump = 4.0;
constexpr double kNewKeyTurn = 0.99;  // cosine of half the turn after which points are renewed
constexpr double kNewKeyShare =
    0.55;  // of the points: they are renewed if fewer lie on the surface
constexpr double kSymmetryWindow = 45.0;  // frames over which the plane of the surface is averaged
constexpr double kFirstPlanes = 5.0;      // frames
constexpr double kSymmetryNoise = 0.02;   // metres: what left and right of a clothed body differ by
// How far the plane of the joints may be off: roll and yaw in radians, and metres aside.
const Eigen::Vector3d kPlaneBias(0.03, 0.04, 0.012);
constexpr double kLegRoll = 0.005;  // a leaning trunk says little about the roll of the pelvis
constexpr double kLeftTilt = 0.2;  // share of the spine's sideways tilt that a plane for legs keeps
constexpr double kUnknown = 0.04;  // square metres: variance of a joint never seen
constexpr double kShoulders = 0.35, kHips = 0.18;  // metres between those of an adult
// Shoulders are twice as far apart as hips, so halved they count as much: for legs.
constexpr double kOtherPair = 0.5;

constexpr std::array kTrunkJoints = {kSpineBase,    kSpineMid,      kSpineShoulder, kNeck,
                                     kShoulderLeft, kShoulderRight, kHipLeft,       kHipRight};
constexpr std::array kMiddle = {kSpineBase, kSpineMid, kSpineShoulder, kNeck};

/// The rotation by a small vector, without transcendental functions: exact to third order.
Eigen::Quaterniond small_turn(const Eigen::Vector3d& w) {
  return Eigen::Quaterniond(1.0, 0.5 * w.x(), 0.5 * w.y(), 0.5 * w.z()).normalized();
}

/// Turns a vector of the trunk about the spine, its y axis. As in small_turn(), the tangent of half
/// the angle is taken as half the angle.
Eigen::Vector3d about_spine(const Eigen::Vector3d& p, double angle) {
  const double half = 0.5 * angle, scale = 1.0 / (1.0 + half * half);
  const double c = (1.0 - half * half) * scale, s = 2.0 * half * scale;
  return {c * p.x() + s * p.z(), p.y(), c * p.z() - s * p.x()};
}

bool is_on_pelvis(Joint joint) {
  return joint == kSpineBase || joint == kHipLeft || joint == kHipRight;
}

Eigen::Matrix3d axes_of(const BodyFrame& frame) {
  Eigen::Matrix3d axes;
  axes << frame.n, frame.y, frame.z;
  return axes;
}

struct Line {
  Eigen::Vector3d point = Eigen::Vector3d::Zero(), direction = Eigen::Vector3d::Zero();
};

using JointTrust = std::array<double, kNumJoints>;

double trust_of(const JointTrust& trust, Joint joint) {
  return trust[static_cast<std::size_t>(joint)];
}

/// The least-squares line through the joints of the middle, up the spine.
std::optional<Line> middle_line(const Skeleton& skeleton, const JointTrust& trust) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weight = 0.0;
  int count = 0;
  for (const Joint joint : kMiddle) {
    if (!is_usable(skeleton, joint)) continue;
    sum += trust_of(trust, joint) * skeleton[joint].cast<double>();
    weight += trust_of(trust, joint);
    ++count;
  }
  if (count < 2) return std::nullopt;
  Line line;
  line.point = sum / weight;
  // The heights along the spine weigh the joints: those farther from the mean tell more.
  constexpr std::array kHeights = {0.0, 0.31, 0.535, 0.61};  // of kMiddle above SpineBase, metres
  double mean = 0.0;
  for (std::size_t i = 0; i < kMiddle.size(); ++i) {
    if (!is_usable(skeleton, kMiddle[i])) continue;
    mean += kHeights[i] * trust_of(trust, kMiddle[i]) / weight;
  }
  for (std::size_t i = 0; i < kMiddle.size(); ++i) {
    if (!is_usable(skeleton, kMiddle[i])) continue;
    line.direction += trust_of(trust, kMiddle[i]) * (kHeights[i] - mean) *
                      (skeleton[kMiddle[i]].cast<double>() - line.point);
  }
  constexpr double kShortest = 1e-3;  // square metres
  if (!(count * line.direction.norm() > kShortest * weight)) return std::nullopt;
  line.direction.normalize();
  return line;
}

struct JointPair {
  Eigen::Vector3d across;  ///< From right to left.
  double trust = 0.0;      ///< Trust of the less trusted of the two joints.
};

/// A joint that is missing is replaced by the middle of the spine.
std::optional<JointPair> pair_of(const Skeleton& skeleton, const JointTrust& trust, Joint left,
                                 Joint right, Joint middle) {
  const bool has_left = is_usable(skeleton, left), has_right = is_usable(skeleton, right);
  const auto between = [&](Joint from, Joint to, double times) {
    return JointPair{times * (skeleton[to] - skeleton[from]).cast<double>(),
                     std::min(trust_of(trust, from), trust_of(trust, to))};
  };
  if (has_left && has_right) return between(right, left, 1.0);
  if (!(has_left || has_right) || !is_usable(skeleton, middle)) return std::nullopt;
  return has_left ? between(middle, left, 2.0) : between(right, middle, 2.0);
}

/// Takes most of the sideways tilt out of a plane for legs: a pelvis stays level on a seat and over
/// two feet where the spine leans. What tilts by more is believed, as a sensor may lie on its side.
void level(BodyFrame& frame, const Eigen::Vector3d& down) {
  constexpr double kShare = 1.0 - kLeftTilt, kBelieved = 0.25;  // of the tilt; its sine
  const double tilt = frame.n.dot(down);
  const double share = kShare / (1.0 + (tilt * tilt) / (kBelieved * kBelieved));
  frame.n = (frame.n - share * tilt * down).normalized();
  frame.x = frame.n;
  frame.y = (frame.y - frame.y.dot(frame.n) * frame.n).normalized();
  frame.z = frame.n.cross(frame.y);
}

/// The normal of the least-squares plane z = a x + b y + c through the points around a pixel,
/// towards the camera; none on edges.
std::optional<Eigen::Vector3d> normal_at(const DepthView& depth, const PixelRays& rays,
                                         std::int32_t pixel) {
  constexpr double kReach = 0.05;       // metres: wide, as one step of a Kinect V1 is 2 cm
  constexpr double kSameTrunk = 0.08;   // metres
  constexpr double kLeastCosine = 0.3;  // surfaces seen at a slant are edges
  const std::int64_t u = pixel % depth.cols, v = pixel / depth.cols;
  if (u < 1 || v < 1 || u + 1 >= depth.cols || v + 1 >= depth.rows) return std::nullopt;
  const double z = depth.at(pixel);
  const Eigen::Vector3d p = lift(rays, u, v, static_cast<float>(z)).cast<double>();
  const double pitch = (lift(rays, u + 1, v, 1.0F) - lift(rays, u - 1, v, 1.0F)).norm() * 0.5 * z;
  if (!(pitch > 1e-5)) return std::nullopt;
  const auto reach = static_cast<std::int64_t>(std::clamp(kReach / pitch, 2.0, 24.0));
  const std::int64_t step = std::max<std::int64_t>(1, reach / 4);
  Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
  Eigen::Vector3d sums = Eigen::Vector3d::Zero();
  int used = 0, asked = 0;
  for (std::int64_t dv = -reach; dv <= reach; dv += step) {
    for (std::int64_t du = -reach; du <= reach; du += step) {
      ++asked;
      if (u + du < 0 || v + dv < 0 || u + du >= depth.cols || v + dv >= depth.rows) continue;
      const auto other = static_cast<std::int32_t>((v + dv) * depth.cols + u + du);
      const float there = depth.at(other);
      if (!(std::abs(there - z) < kSameTrunk) || !has_ray(rays, u + du, v + dv)) continue;
      const Eigen::Vector3d q = lift(rays, u + du, v + dv, there).cast<double>() - p;
      const Eigen::Vector3d row(q.x(), q.y(), 1.0);
      moments += row * row.transpose();
      sums += q.z() * row;
      ++used;
    }
  }
  if (4 * used < 3 * asked) return std::nullopt;
  const Eigen::Vector3d slope = solve_symmetric(moments, sums);
  const Eigen::Vector3d normal = Eigen::Vector3d(slope.x(), slope.y(), -1.0).normalized();
  if (!(-normal.dot(p) > kLeastCosine * p.norm())) return std::nullopt;
  return normal;
}

/// How far the depth image is from a point of a surface, along its normal.
struct SurfaceResidual {
  double off = 0.0;    ///< Metres.
  double share = 1.0;  ///< The Geman-McClure weight is 1 / share^2.
  [[nodiscard]] bool agrees() const { return std::abs(off) < kAgreement; }
  [[nodiscard]] double weight(double noise) const { return 1.0 / (noise * noise * share * share); }
};

/// At the pixel that a point projects to; none where nothing was measured.
std::optional<SurfaceResidual> residual_at(const Eigen::Vector3d& p, const Eigen::Vector3d& normal,
                                           const DepthView& depth, const PixelRays& rays,
                                           const PixelProjector& projector,
                                           double scale = kSurfaceScale) {
  const std::int32_t pixel = projector.pixel(static_cast<float>(p.x()), static_cast<float>(p.y()),
                                             static_cast<float>(p.z()));
  if (pixel < 0) return std::nullopt;
  const float z = depth.at(pixel);
  if (!(z > 0.0F)) return std::nullopt;
  const Eigen::Vector3d q = lift(rays, pixel % depth.cols, pixel / depth.cols, z).cast<double>();
  const double off = normal.dot(q - p);
  return SurfaceResidual{off, 1.0 + (off * off) / (scale * scale)};
}

bool is_on_trunk(std::uint8_t bone) {
  switch (static_cast<Joint>(bone)) {
    case kSpineMid:
    case kSpineShoulder:
    case kShoulderLeft:
    case kShoulderRight:
    case kHipLeft:
    case kHipRight:
      return true;
    default:
      return false;
  }
}

}  // namespace

namespace {

/// trunk_frame(), where each joint counts by its trust: 1 is that of an exact one.
std::optional<BodyFrame> trusted_frame(const Skeleton& skeleton, Limb limb, const JointTrust& trust,
                                       const Eigen::Vector3d& down) {
  const auto line = middle_line(skeleton, trust);
  if (!line) return std::nullopt;
  const bool arm = is_arm(limb);
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  double weight = 0.0;
  const auto add = [&](const std::optional<JointPair>& pair, double share) {
    if (!pair) return;
    x += share * pair->trust * pair->across;
    weight += pair->trust;
  };
  add(pair_of(skeleton, trust, kShoulderLeft, kShoulderRight, kSpineShoulder),
      arm ? 1.0 : kOtherPair);
  add(pair_of(skeleton, trust, kHipLeft, kHipRight, kSpineBase), arm ? kOtherPair : 1.0);
  // Metres from right to left; sine of the angle between x and the spine; metres before the camera.
  constexpr double kShortest = 0.05, kLeastSine = 0.1, kNearest = 0.1;
  if (!(x.norm() > kShortest * std::min(weight, 1.0))) return std::nullopt;
  BodyFrame frame;
  frame.x = x.normalized();
  frame.y = line->direction;
  frame.z = frame.x.cross(frame.y);
  if (!(frame.z.norm() > kLeastSine)) return std::nullopt;
  frame.z.normalize();
  frame.n = frame.y.cross(frame.z);
  const Joint height = arm ? kSpineMid : kSpineBase;
  if (!arm) level(frame, down);
  frame.origin = line->point;
  if (is_usable(skeleton, height)) {
    const Eigen::Vector3d joint = skeleton[height].cast<double>();
    frame.origin = joint - frame.n.dot(joint - line->point) * frame.n;
  }
  if (!(frame.origin.z() > kNearest)) return std::nullopt;
  return frame;
}

}  // namespace

std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb,
                                     const Eigen::Vector3d& down) {
  JointTrust all;
  all.fill(1.0);
  return trusted_frame(skeleton, limb, all, down);
}

TrunkTracker::TrunkTracker(Limb affected) : affected_(affected) {
  surface_.reserve(kMostSurface);
  reset();
}

void TrunkTracker::reset() {
  pose_.reset();
  velocity_.setZero();
  is_contradicted_ = false;
  across_.setZero();
  disagreement_ = 0.0;
  hips_.setZero();
  usual_angle_ = twist_ = 0.0;
  usual_time_ = kFirstUsual;
  pelvis_ = {};
  knee_ = {};
  joints_ = {};
  surface_.clear();
  plane_ = {};
  residual_ = 0.0;
  error_power_ = kFirstErrors * kFirstJitter * kFirstJitter;
  error_product_ = kFirstCorrelation * error_power_;
  turn_variance_ = 0.0;
  covariance_.reset();
  surface_share_ = 0.0;
}

/// Begins to follow the trunk at this frame. It is the same person, so the measured jitter of the
/// joints is kept; all else is forgotten.
void TrunkTracker::start(const BodyFrame& frame) {
  std::array<double, kNumJoints> jitter{};
  for (std::size_t i = 0; i < kNumJoints; ++i) jitter[i] = joints_[i].jitter;
  const double power = error_power_, product = error_product_;
  reset();
  for (std::size_t i = 0; i < kNumJoints; ++i) joints_[i].jitter = jitter[i];
  error_power_ = power;
  error_product_ = product;
  pose_ = Pose{Eigen::Quaterniond(axes_of(frame)), frame.origin};
}

/// Forgets the pose, which tells nothing of where the trunk is after a gap.
void TrunkTracker::end_motion() {
  pose_.reset();
  covariance_.reset();
  for (JointMean& mean : joints_) mean.num_last = 0;
}

std::optional<BodyFrame> TrunkTracker::update(const Skeleton* joints, const DepthView& depth,
                                              const PixelRays& rays, const Intrinsics& camera,
                                              double time_s) {
  const double elapsed = time_s - time_s_, without_joints = time_s - joints_time_s_;
  const bool are_back = joints != nullptr && without_joints > kGap;
  if (pose_ && (elapsed > kGap || are_back)) end_motion();
  const bool jumps = pose_ && joints != nullptr && has_jumped(*joints, std::max(elapsed, 1e-3));
  if (joints != nullptr) {
    measure_jitter(*joints);
    joints_time_s_ = time_s;
  }
  if (pose_ && joints != nullptr && contradicts(*joints)) {
    if (!is_contradicted_) contradicted_since_ = time_s;
    is_contradicted_ = true;
    if (time_s - contradicted_since_ > kContradictionTime) pose_.reset();
  } else if (joints != nullptr || !pose_) {  // joints may come less often than images
    is_contradicted_ = false;
  }
  if (pose_) {
    follow(joints, depth, rays, camera, std::max(elapsed, 1e-3), jumps);
  } else if (joints != nullptr) {
    const auto frame = trunk_frame(*joints, affected_, down_);
    if (!frame) return std::nullopt;
    start(*frame);
    measure_jitter(*joints);
  } else {
    return std::nullopt;
  }
  if (joints != nullptr && !is_contradicted_) average_joints(*joints);
  measure_symmetry(depth, rays, camera);
  if (jumps) across_.setZero();  // what was before the turn tells nothing
  if (joints != nullptr) {
    compare_turn(*joints, without_joints);
    compare_hips(*joints, without_joints);
  }
  time_s_ = time_s;
  return frame();
}

/// One frame on: predicts, fits, and learns the velocity.
void TrunkTracker::follow(const Skeleton* joints, const DepthView& depth, const PixelRays& rays,
                          const Intrinsics& camera, double elapsed, bool jumps) {
  const Pose before = *pose_;
  pose_->rotation = (small_turn(elapsed * velocity_.head<3>()) * pose_->rotation).normalized();
  pose_->translation += elapsed * velocity_.tail<3>();
  // A body that turned too far for its surface is looked for as if frames had been missed.
  const double unseen = jumps ? std::max(elapsed, kMissed + kFrameTime) : elapsed;
  fit(is_contradicted_ ? nullptr : joints, depth, rays, camera, unseen);
  follow_pelvis(is_contradicted_ ? nullptr : joints, depth, rays, camera, elapsed);
  if (jumps) {  // trackers jump, and a body that did would not go on so
    velocity_.setZero();
    return;
  }
  const Eigen::Quaterniond turn = pose_->rotation * before.rotation.conjugate();
  Vector6 seen;
  seen << (turn.w() < 0.0 ? -2.0 : 2.0) * turn.vec(), pose_->translation - before.translation;
  velocity_ = kStepMemory * velocity_ + (1.0 - kStepMemory) * seen / elapsed;
}

/// The axes of the joints' means, with the plane that the surface has told.
std::optional<BodyFrame> TrunkTracker::frame() const {
  if (!pose_) return std::nullopt;
  return frame_at(end_of_limb());
}

std::optional<BodyFrame> TrunkTracker::frame_at(const Pose& pose) const {
  auto frame = trusted_frame(mean_skeleton(pose), affected_, joint_trust(), down_);
  if (!frame || plane_.weight == 0.0) return frame;
  const Eigen::Vector3d n = (pose.rotation * plane_.normal).normalized();
  frame->origin += (plane_.offset - n.dot(frame->origin - pose.translation)) * n;
  frame->n = frame->x = n;
  frame->y = (frame->y - frame->y.dot(n) * n).normalized();
  frame->z = n.cross(frame->y);
  return frame;
}

/// Lays the mirrored points of the key frame onto the depth image: the plane that fits best, with
/// that of the joints as a prior.
///
/// With n, o the plane, s = n (p - o), the mirror image p' = p - 2 s n and its normal m', a turn of
/// n by a y + b z and a shift of o by c n move p' by -2 (a y (p - o) + b z (p - o) - c) n -
/// 2 s (a y + b z).
void TrunkTracker::measure_symmetry(const DepthView& depth, const PixelRays& rays,
                                    const Intrinsics& camera) {
  const auto axes = trusted_frame(mean_skeleton(*pose_), affected_, joint_trust(), down_);
  if (!axes) return;
  if (surface_.size() < kLeastSurface) {
    covariance_ =
        Eigen::Matrix3d(joint_plane_variance(axes->n).cwiseInverse().asDiagonal()).inverse();
    return;
  }
  const PixelProjector projector(camera, rays);
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  // A plane that is held at joints beside the flesh turns to fit the surface.
  const double aside = offset_along(axes->n);
  Eigen::Vector3d variance = joint_plane_variance(axes->n);
  variance[2] += kUnknownOffset * kUnknownOffset * aside * aside;
  const Eigen::Vector3d prior = variance.cwiseInverse();
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  std::size_t agreed = 0;
  const Eigen::Vector3d origin = axes->origin + aside * axes->n;
  Eigen::Vector3d n = axes->n, o = origin;
  Eigen::Matrix3d told;  // information of the surface alone
  // Later the last frames' planes are near; at first that of the joints may be far off.
  const int wider = plane_.weight < kFirstPlanes ? 4 : 0;
  for (int iteration = -wider; iteration < 2; ++iteration) {
    const double scale = kSurfaceScale * (iteration < 0 ? 1.0 - 0.5 * iteration : 1.0);
    told.setZero();
    Eigen::Vector3d gradient = -prior.cwiseProduct(moved);
    agreed = 0;
    for (const SurfacePoint& point : surface_) {
      const Eigen::Vector3d from = rotation * point.place + pose_->translation - o;
      const double s = n.dot(from);
      const Eigen::Vector3d turned = rotation * point.normal;
      Eigen::Vector3d p = from + o - 2.0 * s * n, normal = turned - 2.0 * n.dot(turned) * n;
      // The key frame is not twisted: the trunk is mirrored first, then twisted as it is now.
      if (const double turn = point.share * pelvis_.turn; turn != 0.0) {
        const Eigen::Matrix3d back = rotation.transpose();
        p = rotation * about_spine(back * (p - pose_->translation), turn) + pose_->translation;
        normal = rotation * about_spine(back * normal, turn);
      }
      constexpr double kLeastCosine = 0.3;  // of surfaces that the camera sees
      if (!(-normal.dot(p) > kLeastCosine * p.norm())) continue;
      const auto found = residual_at(p, normal, depth, rays, projector, scale);
      if (!found) continue;
      if (found->agrees()) ++agreed;
      const double weight = found->weight(kSymmetryNoise);
      const double across = -2.0 * normal.dot(n);
      const Eigen::Vector3d row(across * axes->y.dot(from) - 2.0 * s * normal.dot(axes->y),
                                across * axes->z.dot(from) - 2.0 * s * normal.dot(axes->z),
                                -across);
      told += weight * row * row.transpose();
      gradient += weight * found->off * row;
    }
    const Eigen::Matrix3d information = told + Eigen::Matrix3d(prior.asDiagonal());
    moved += solve_symmetric(information, gradient);
    n = (axes->n + moved[0] * axes->y + moved[1] * axes->z).normalized();
    o = origin + moved[2] * axes->n;
  }
  Eigen::Matrix3d known = prior.asDiagonal();
  if (agreed >= kLeastSurface) known += told / (kSharedNoise * kSharedNoise);
  covariance_ = known.inverse();
  if (agreed < kLeastSurface) return;
  plane_.weight = std::min(plane_.weight + 1.0, kSymmetryWindow);
  const double gain = 1.0 / plane_.weight;
  plane_.normal += gain * (pose_->rotation.conjugate() * n - plane_.normal);
  plane_.offset += gain * (n.dot(o - pose_->translation) - plane_.offset);
}

/// How far the flesh of the trunk lies beside its joints in a direction, metres: as far as that of
/// the limbs where this is beyond the errors that their own joints have. The weight's power of four
/// was chosen on the tuning half of benchmarks/bench_people.py, whose limbs lie up to 3.2 cm aside.
double TrunkTracker::offset_along(const Eigen::Vector3d& n) const {
  const double off = offset_.dot(n), ratio = off * off / (kJointBias * kJointBias);
  return off * ratio * ratio / (1.0 + ratio * ratio);
}

double TrunkTracker::deviation_deg() const {
  if (!covariance_) return std::numeric_limits<double>::infinity();
  constexpr double kDegrees = 57.29577951308232;
  const Eigen::Matrix3d& plane = *covariance_;
  const double known = kDegrees * std::sqrt(turn_variance_ + plane(0, 0) + plane(1, 1));
  return std::hypot(known, std::max(disagreement_, twist_) / kDegree);
}

double TrunkTracker::deviation_at(const Eigen::Vector3d& p, const BodyFrame& frame) const {
  const Eigen::Vector3d from = p - frame.origin;
  const Eigen::Vector3d row(frame.y.dot(from), frame.z.dot(from), -1.0);
  const double within = covariance_ ? row.dot(*covariance_ * row) : 0.0;
  return std::sqrt(within + turn_variance_ * row.head<2>().squaredNorm());
}

/// How large the trunk of the joints' means is against an adult's, by its shoulders and its spine;
/// 1 for larger ones, and as long as neither is known.
double TrunkTracker::size_against_adult() const {
  constexpr double kLeast = 0.4;  // of an adult: joints that are nearer to each other are wrong
  constexpr std::array<std::tuple<Joint, Joint, double>, 2> kLengths = {
      {{kShoulderLeft, kShoulderRight, kShoulders},
       {kSpineBase, kSpineShoulder, 0.535}}};  // metres
  double sum = 0.0, adult = 0.0;
  for (const auto& [from, to, length] : kLengths) {
    const JointMean& a = joints_[static_cast<std::size_t>(from)];
    const JointMean& b = joints_[static_cast<std::size_t>(to)];
    if (a.weight == 0.0 || b.weight == 0.0) continue;
    sum += (a.place - b.place).norm();
    adult += length;
  }
  return adult > 0.0 ? std::clamp(sum / adult, kLeast, 1.0) : 1.0;
}

/// Variance that the vertical has along the normal of a leg's plane, square radians. Continuous:
/// none up to a deviation of a degree, which poses of level cameras leave, and all from twice that.
double TrunkTracker::level_variance(const Eigen::Vector3d& n) const {
  const double variance = std::max(0.0, n.dot(down_covariance_ * n));
  return variance * std::clamp(std::sqrt(variance) / kDegree - 1.0, 0.0, 1.0);
}

/// Variances of the plane with a normal that the joints tell: its roll and yaw, and metres aside.
Eigen::Vector3d TrunkTracker::joint_plane_variance(const Eigen::Vector3d& n) const {
  const auto variance = [&](Joint joint) {
    const JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    return mean.weight > 0.0 ? mean_variance(mean) : kUnknown;
  };
  const JointTrust trusted = joint_trust();
  // Yaw: variance of the mean of both pairs' directions, weighted by trust, over its squared
  // length.
  const double size = size_against_adult();
  const bool arm = is_arm(affected_);
  const auto pair_trust = [&](Joint left, Joint right) {
    return std::min(trust_of(trusted, left), trust_of(trusted, right));
  };
  const double a = (arm ? 1.0 : kOtherPair) * pair_trust(kShoulderLeft, kShoulderRight);
  const double b = (arm ? kOtherPair : 1.0) * pair_trust(kHipLeft, kHipRight);
  const double length = std::max(size * (a * kShoulders + b * kHips), 1e-3);
  const double yaw = (a * a * (variance(kShoulderLeft) + variance(kShoulderRight)) +
                      b * b * (variance(kHipLeft) + variance(kHipRight))) /
                     (length * length);
  // Roll: variance of the slope of a line through the middle joints.
  constexpr double kSpine = 0.25;  // metres: deviation of their heights
  double precision = 0.0;
  for (const Joint joint : kMiddle) precision += 1.0 / (variance(joint) + 1e-6);
  // Joints are off by metres: the smaller a body, the more its axes are turned by them.
  Eigen::Vector3d bias(kPlaneBias[0] / size, kPlaneBias[1] / size, kPlaneBias[2]);
  double roll = 1.0 / (precision * size * size * kSpine * kSpine);
  if (!arm) {
    bias[0] = kLegRoll;
    roll *= kLeftTilt * kLeftTilt;
    roll += (1.0 - kLeftTilt) * (1.0 - kLeftTilt) * level_variance(n);
  }
  return bias.cwiseProduct(bias) + Eigen::Vector3d(roll, yaw, 1.0 / precision);
}

/// Are most joints far from where they are in the trunk, or is the plane turned against them?
bool TrunkTracker::contradicts(const Skeleton& joints) const {
  if (disagreement_ > 0.0) return true;
  int off = 0, all = 0;
  for (const Joint joint : kTrunkJoints) {
    const JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (mean.weight == 0.0 || !is_usable(joints, joint)) continue;
    ++all;
    const Eigen::Vector3d place = (*pose_)(place_of(joint, pelvis_.turn));
    if ((joints[joint].cast<double>() - place).norm() > kContradiction) ++off;
  }
  return 2 * off > all;
}

/// From right to left, of the shoulders and half of the hips, as far as both of a pair are tracked.
std::optional<TrunkTracker::Across> TrunkTracker::tracked_across(const Skeleton& joints) const {
  Across across;
  double length = 0.0, variance = 0.0;
  const auto add = [&](Joint left, Joint right, double share, double width) {
    for (const Joint joint : {left, right}) {
      if (!is_usable(joints, joint) || joints.state(joint) != TrackingState::kTracked) return;
    }
    Eigen::Vector3d direction = (joints[left] - joints[right]).cast<double>();
    if (is_on_pelvis(left) && pelvis_.turn != 0.0) {
      direction =
          pose_->rotation * about_spine(pose_->rotation.conjugate() * direction, -pelvis_.turn);
    }
    across.direction += share * direction;
    length += share * width;
    for (const Joint joint : {left, right}) {
      variance += share * share * joints_[static_cast<std::size_t>(joint)].jitter;
    }
  };
  add(kShoulderLeft, kShoulderRight, 1.0, kShoulders);
  add(kHipLeft, kHipRight, kOtherPair, kHips);
  if (across.direction.isZero(0.0)) return std::nullopt;
  across.jitter = std::sqrt(variance) / length;
  return across;
}

/// Has the direction across jumped against that of the last frames, carried on with the trunk?
bool TrunkTracker::has_jumped(const Skeleton& joints, double elapsed) const {
  const auto across = tracked_across(joints);
  if (!across || across_.isZero(0.0)) return false;
  const Eigen::Quaterniond rotation = small_turn(elapsed * velocity_.head<3>()) * pose_->rotation;
  const Eigen::Vector3d foreseen = rotation * across_;
  const double cosine = foreseen.dot(across->direction);
  const double turn = std::atan2(foreseen.cross(across->direction).norm(), cosine);
  return turn > std::max(kMostJump, kSureJump * across->jitter) &&
         off_as_a_whole(joints) < kJointScale;
}

/// Mean distance of the tracked joints from where they are in the trunk, metres, once the trunk is
/// laid onto them [Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976].
double TrunkTracker::off_as_a_whole(const Skeleton& joints) const {
  std::array<Eigen::Vector3d, kTrunkJoints.size()> places, told;
  std::size_t count = 0;
  Eigen::Vector3d place_sum = Eigen::Vector3d::Zero(), told_sum = Eigen::Vector3d::Zero();
  for (const Joint joint : kTrunkJoints) {
    const JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (mean.weight == 0.0 || !is_usable(joints, joint)) continue;
    if (joints.state(joint) != TrackingState::kTracked) continue;
    place_sum += places[count] = place_of(joint, pelvis_.turn);
    told_sum += told[count] = joints[joint].cast<double>();
    ++count;
  }
  if (count == 0) return 0.0;
  const auto n = static_cast<double>(count);
  const Eigen::Vector3d place_mean = place_sum / n, told_mean = told_sum / n;
  Eigen::Matrix3d products = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    products += (told[i] - told_mean) * (places[i] - place_mean).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(products, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d u = svd.matrixU(), v = svd.matrixV();
  const Eigen::Vector3d hand(1.0, 1.0, (u * v.transpose()).determinant() < 0.0 ? -1.0 : 1.0);
  const Eigen::Matrix3d rotation = u * hand.asDiagonal() * v.transpose();
  double off = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    off += (told[i] - told_mean - rotation * (places[i] - place_mean)).norm();
  }
  return off / n;
}

/// How far the plane is turned about the spine against the shoulders and hips that were tracked
/// lately. They are averaged within the trunk, so that a body that turns is not behind.
void TrunkTracker::compare_turn(const Skeleton& joints, double elapsed) {
  disagreement_ = 0.0;
  if (!pose_) return;
  const auto axes = frame_at(*pose_);
  if (!axes) return;
  const auto across = tracked_across(joints);
  if (!across) {
    across_.setZero();
    return;
  }
  const Eigen::Vector3d within = pose_->rotation.conjugate() * across->direction;
  const double gain = across_.isZero(0.0) ? 1.0 : 1.0 - std::exp(-elapsed / kAcrossTime);
  across_ += gain * (within - across_);
  const Eigen::Vector3d mean = pose_->rotation * across_;
  const double turn = std::abs(std::atan2(axes->z.dot(mean), axes->n.dot(mean)));
  // The variance that an exponential mean leaves of white noise at 30 frames a second: a / (2 - a),
  // a = 1 - e^(-1/3).
  constexpr double kLeft = 0.165;
  const double deviation = std::sqrt(kLeft) * across->jitter;
  if (!(turn > kMostDisagreement + 2.0 * deviation)) return;
  disagreement_ = turn;
}

/// How far the plane of a leg is turned about the spine against the hips, from what it usually is:
/// what of a twist the pelvis was not seen to turn by.
void TrunkTracker::compare_hips(const Skeleton& joints, double elapsed) {
  twist_ = 0.0;
  const auto axes = frame();
  if (is_arm(affected_) || !axes) return;
  double variance = 0.0;
  for (const Joint joint : {kHipLeft, kHipRight}) {
    if (!is_usable(joints, joint) || joints.state(joint) != TrackingState::kTracked) {
      hips_.setZero();
      return;
    }
    variance += innovation(joints_[static_cast<std::size_t>(joint)]);
  }
  const Eigen::Vector3d across = (joints[kHipLeft] - joints[kHipRight]).cast<double>();
  const double step = std::clamp(elapsed, 1e-3, kGap);
  const double gain = hips_.isZero(0.0) ? 1.0 : 1.0 - std::exp(-step / kHipsTime);
  const Eigen::Quaterniond rotation = end_of_limb().rotation;
  hips_ += gain * (rotation.conjugate() * across - hips_);
  const Eigen::Vector3d mean = rotation * hips_;
  const double z = axes->z.dot(mean), n = axes->n.dot(mean), angle = std::atan2(z, n);
  usual_time_ = std::min(usual_time_ + step, kUsualTime);
  const double off = std::remainder(angle - usual_angle_, 2.0 * std::numbers::pi);
  usual_angle_ += step / usual_time_ * off;
  // The variance of an exponential mean of first-order autoregressive errors. `variance` is that of
  // what is new in each frame; over 1 - rho^2 it is that of the errors; a mean that keeps `kept`
  // from frame to frame leaves (1 - kept) / (1 + kept) (1 + rho kept) / (1 - rho kept) of it.
  const double rho = correlation(), kept = std::exp(-kFrameTime / kHipsTime);
  variance *=
      (1.0 - kept) / (1.0 + kept) * (1.0 + rho * kept) / (1.0 - rho * kept) / (1.0 - rho * rho);
  const double turn = std::abs(std::remainder(angle - usual_angle_, 2.0 * std::numbers::pi));
  if (turn > kMostTwist + 1.5 * std::sqrt(variance) / std::hypot(z, n)) twist_ = turn;
}

/// Gauss-Newton steps about the predicted pose.
void TrunkTracker::fit(const Skeleton* joints, const DepthView& depth, const PixelRays& rays,
                       const Intrinsics& camera, double elapsed) {
  const PixelProjector projector(camera, rays);
  Vector6 moved = Vector6::Zero();
  NormalEquations equations;
  // Motion adds up: what is not foreseen, and how far joints may be from where they were foreseen,
  // grows with time. After frames were missed the joints alone say where the surface is looked for.
  const double frames = std::max(1.0, elapsed / kFrameTime);
  const int alone = joints != nullptr && elapsed > kMissed ? 2 : 0;
  for (int iteration = -alone; iteration < kIterations; ++iteration) {
    equations = motion_prior(moved, frames);
    const Agreement agreed =
        iteration < 0 ? Agreement() : add_surface(depth, rays, projector, equations);
    if (iteration + 1 == kIterations && agreed.points >= kLeastSurface) {
      constexpr double kMemory = 0.9;  // from frame to frame
      residual_ =
          kMemory * residual_ + (1.0 - kMemory) * agreed.off / static_cast<double>(agreed.points);
    }
    surface_share_ = surface_.empty() ? 0.0
                                      : static_cast<double>(agreed.points) /
                                            static_cast<double>(surface_.size());
    if (joints != nullptr) add_joints(*joints, frames * kJointScale, equations);
    const Vector6 step = solve_symmetric(equations.information, equations.gradient);
    moved += step;
    pose_->rotation = (small_turn(step.head<3>()) * pose_->rotation).normalized();
    pose_->translation += step.tail<3>();
  }
  const Matrix6 covariance = equations.information.ldlt().solve(Matrix6::Identity());
  turn_variance_ = covariance.topLeftCorner<3, 3>().trace() / 3.0;
}

/// The trunk is where it was foreseen, by Cauchy weights of what it has moved from there.
TrunkTracker::NormalEquations TrunkTracker::motion_prior(const Vector6& moved, double frames) {
  const double turn_noise = frames * kTurnNoise, move_noise = frames * kMoveNoise;
  const double turn2 = turn_noise * turn_noise + moved.head<3>().squaredNorm();
  const double move2 = move_noise * move_noise + moved.tail<3>().squaredNorm();
  Vector6 prior;
  prior << Eigen::Vector3d::Constant(1.0 / turn2), Eigen::Vector3d::Constant(1.0 / move2);
  return {prior.asDiagonal(), -prior.cwiseProduct(moved)};
}

/// The points of the key frame lie on the surface that is seen now.
TrunkTracker::Agreement TrunkTracker::add_surface(const DepthView& depth, const PixelRays& rays,
                                                  const PixelProjector& projector,
                                                  NormalEquations& equations) const {
  const double surface_noise = std::max(kSurfaceNoise, kSharedNoise * residual_);
  const Eigen::Vector3d centre = pose_->translation;
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  Agreement agreed;
  for (const SurfacePoint& point : surface_) {
    const double turn = point.share * pelvis_.turn;
    const Eigen::Vector3d p = rotation * about_spine(point.place, turn) + centre;
    const Eigen::Vector3d normal = rotation * about_spine(point.normal, turn);
    const auto found = residual_at(p, normal, depth, rays, projector);
    if (!found) continue;
    if (found->agrees()) {
      ++agreed.points;
      agreed.off += std::abs(found->off);
    }
    const double weight = found->weight(surface_noise);
    Vector6 row;
    row << (p - centre).cross(normal), normal;
    equations.information += weight * row * row.transpose();
    equations.gradient += weight * found->off * row;
  }
  return agreed;
}

/// The joints are where they were in the trunk on average.
/// @param scale  of their Cauchy weights, metres.
void TrunkTracker::add_joints(const Skeleton& joints, double scale,
                              NormalEquations& equations) const {
  const double rho = correlation();
  const Eigen::Vector3d centre = pose_->translation;
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  for (const Joint joint : kTrunkJoints) {
    const JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (mean.weight == 0.0 || !is_usable(joints, joint)) continue;
    const Eigen::Vector3d arm = rotation * place_of(joint, pelvis_.turn);
    const Eigen::Vector3d whole = joints[joint].cast<double>() - arm - centre;
    // Errors that drift are known from the last frame but for what is new of them.
    const Eigen::Vector3d off = whole - rho * (rotation * mean.last_error);
    const double noise = std::clamp(std::sqrt(innovation(mean)), kLeastJointNoise, kMostJointNoise);
    const double share = 1.0 + off.squaredNorm() / (scale * scale);
    const double weight = 1.0 / (noise * noise * share);
    Eigen::Matrix<double, 3, 6> rows;
    rows << 0.0, arm.z(), -arm.y(), 1.0, 0.0, 0.0,  //
        -arm.z(), 0.0, arm.x(), 0.0, 1.0, 0.0,      //
        arm.y(), -arm.x(), 0.0, 0.0, 0.0, 1.0;
    equations.information += weight * rows.transpose() * rows;
    equations.gradient += weight * rows.transpose() * off;
  }
}

/// Follows the turn of the pelvis against the trunk, by its own surface and joints and by a thigh
/// on a seat. Only this angle has a memory: what the pelvis has moved by keeps a trunk that turned
/// with the chest from hiding it, as a front that turns looks much like one that moves aside.
void TrunkTracker::follow_pelvis(const Skeleton* joints, const DepthView& depth,
                                 const PixelRays& rays, const Intrinsics& camera, double elapsed) {
  if (is_arm(affected_)) return;
  constexpr double kTurnWeight = 1.0 / (kUsualTurn * kUsualTurn),
                   kMoveWeight = 1.0 / (kPelvisMove * kPelvisMove);
  const PixelProjector projector(camera, rays);
  const double foreseen = pelvis_.told;
  const double changed = elapsed / kFrameTime * kTurnChange * kTurnChange;
  const Eigen::Vector4d prior(1.0 / (pelvis_.variance + changed), kMoveWeight, kMoveWeight,
                              kMoveWeight);
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  PelvisEquations equations;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    equations.information = prior.asDiagonal();
    equations.gradient << prior[0] * (foreseen - pelvis_.told), -kMoveWeight * moved;
    equations.information(0, 0) += kTurnWeight;
    equations.gradient[0] -= kTurnWeight * pelvis_.told;
    add_pelvis_surface(moved, depth, rays, projector, equations);
    if (joints != nullptr) add_pelvis_joints(moved, *joints, equations);
    const Eigen::Vector4d step = solve_symmetric(equations.information, equations.gradient);
    pelvis_.told += step[0];
    moved += step.tail<3>();
  }
  pelvis_.variance = equations.information.inverse()(0, 0);
  // Continuous: nothing of the least turn that counts, and all of twice as much.
  const double least = std::max(kLeastTurn, kSureTurn * std::sqrt(pelvis_.variance));
  pelvis_.turn = pelvis_.told * std::clamp(std::abs(pelvis_.told) / least - 1.0, 0.0, 1.0);
}

void TrunkTracker::add_pelvis_surface(const Eigen::Vector3d& moved, const DepthView& depth,
                                      const PixelRays& rays, const PixelProjector& projector,
                                      PelvisEquations& equations) const {
  const double noise = std::max(kSurfaceNoise, kSharedNoise * residual_);
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  const Eigen::Vector3d centre = pose_->translation, spine = rotation.col(1);
  for (const SurfacePoint& point : surface_) {
    if (point.share == 0.0) continue;
    const double turn = point.share * pelvis_.told;
    const Eigen::Vector3d arm = rotation * about_spine(point.place, turn);
    const Eigen::Vector3d normal = rotation * about_spine(point.normal, turn);
    const auto found =
        residual_at(arm + centre + point.share * moved, normal, depth, rays, projector);
    if (!found) continue;
    Eigen::Vector4d row;
    row << spine.dot(arm.cross(normal)), normal;
    row *= point.share;
    equations.add(row, found->off, found->weight(noise));
  }
}

void TrunkTracker::add_pelvis_joints(const Eigen::Vector3d& moved, const Skeleton& joints,
                                     PelvisEquations& equations) const {
  const double rho = correlation();
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  const Eigen::Vector3d centre = pose_->translation + moved, spine = rotation.col(1);
  const auto weight_of = [](double variance, double square) {
    const double noise = std::clamp(std::sqrt(variance), kLeastJointNoise, kMostJointNoise);
    return 1.0 / (noise * noise * (1.0 + square / (kJointScale * kJointScale)));
  };
  for (const Joint joint : {kSpineBase, kHipLeft, kHipRight}) {
    const JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (mean.weight == 0.0 || !is_usable(joints, joint)) continue;
    const Eigen::Vector3d arm = rotation * place_of(joint, pelvis_.told);
    const Eigen::Vector3d off =
        joints[joint].cast<double>() - arm - centre - rho * (rotation * mean.last_error);
    const Eigen::Vector3d turn = spine.cross(arm);
    const double weight = weight_of(innovation(mean), off.squaredNorm());
    for (int axis = 0; axis < 3; ++axis) {
      Eigen::Vector4d row;
      row << turn[axis], Eigen::Vector3d::Unit(axis);
      equations.add(row, off[axis], weight);
    }
  }
  const auto knee = lap(joints);
  if (!knee || knee_.weight == 0.0) return;
  const Eigen::Vector3d arm = rotation * about_spine(knee_.place, pelvis_.told);
  const Eigen::Vector3d turn = spine.cross(arm), aside = turn.normalized();
  const double off = aside.dot(*knee - centre - arm);
  // The knee is told as well as the hip, with errors that last.
  const JointMean& hip = joints_[static_cast<std::size_t>(limb_root(opposite(affected_)))];
  Eigen::Vector4d row;
  row << turn.norm(), aside;
  equations.add(row, off, weight_of(innovation(hip) / (1.0 - rho * rho), off * off));
}

/// The intact knee of a person on a seat, whose lap hides the pelvis: a thigh turns with it there.
std::optional<Eigen::Vector3d> TrunkTracker::lap(const Skeleton& joints) const {
  constexpr double kLeastAhead = 0.25;  // metres from the spine
  const Joint joint = limb_chain(opposite(affected_))[1];
  if (!is_usable(joints, joint) || joints.state(joint) != TrackingState::kTracked) {
    return std::nullopt;
  }
  const Eigen::Vector3d knee = joints[joint].cast<double>();
  const Eigen::Vector3d arm = knee - pose_->translation,
                        spine = pose_->rotation * Eigen::Vector3d::UnitY();
  if (!((arm - spine.dot(arm) * spine).norm() > kLeastAhead)) return std::nullopt;
  return knee;
}

/// The end of the trunk that bears the limb.
TrunkTracker::Pose TrunkTracker::end_of_limb() const {
  if (pelvis_.turn == 0.0) return *pose_;
  const Eigen::Quaterniond turn(1.0, 0.0, 0.5 * pelvis_.turn, 0.0);
  return {(pose_->rotation * turn.normalized()).normalized(), pose_->translation};
}

/// A joint's mean place in the trunk whose pelvis is turned.
Eigen::Vector3d TrunkTracker::place_of(Joint joint, double pelvis_turn) const {
  const Eigen::Vector3d& place = joints_[static_cast<std::size_t>(joint)].place;
  return is_on_pelvis(joint) ? about_spine(place, pelvis_turn) : place;
}

/// Correlation of the joints' errors from one frame to the next.
double TrunkTracker::correlation() const {
  return std::clamp(error_product_ / error_power_, 0.0, kMostCorrelation);
}

/// The variance of what is new in a joint's error from frame to frame. Errors of variance s with
/// correlation rho have second differences of variance 2 s (1 - rho) (3 - rho), which is six times
/// `jitter`; new is s (1 - rho^2).
double TrunkTracker::innovation(const JointMean& mean) const {
  const double rho = correlation();
  return mean.jitter * 3.0 * (1.0 + rho) / (3.0 - rho);
}

/// The variance of a joint's mean: frames that share their errors tell no more than fewer do. At
/// first the correlation of the errors is hardly known. It counts as the highest until then, or
/// joints whose errors last outweigh the surface.
double TrunkTracker::mean_variance(const JointMean& mean) const {
  constexpr double kUnsure = 8.0, kMost = 50.0;  // frames: those that the running sums remember
  const double doubt = kUnsure / std::clamp(mean.weight, kUnsure, kMost);
  const double rho = doubt * kMostCorrelation + (1.0 - doubt) * correlation();
  const double frames = 1.0 + std::max(0.0, mean.weight - 1.0) * (1.0 - rho) / (1.0 + rho);
  return innovation(mean) / ((1.0 - rho * rho) * frames);
}

/// The variance of white noise that would make each joint's second differences.
void TrunkTracker::measure_jitter(const Skeleton& joints) {
  for (const Joint joint : kTrunkJoints) {
    JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (!is_usable(joints, joint)) {
      mean.num_last = 0;
      continue;
    }
    const bool is_guess = joints.state(joint) != TrackingState::kTracked;
    const double least = kFirstJitter * (is_guess ? kGuessed : 1.0);
    const Eigen::Vector3d now = joints[joint].cast<double>();
    if (mean.jitter == 0.0) mean.jitter = least * least;
    if (mean.num_last == 2) {
      constexpr double kMost = 0.1;    // metres: what jumps farther is no jitter
      constexpr double kMemory = 0.9;  // from frame to frame
      const Eigen::Vector3d second = now - 2.0 * mean.last[0] + mean.last[1];
      // White noise of variance s has second differences of variance 6 s in each coordinate.
      const double seen = std::min(second.squaredNorm(), 18.0 * kMost * kMost) / 18.0;
      mean.jitter = kMemory * mean.jitter + (1.0 - kMemory) * seen;
    }
    // A guess may stand still, and is no better for that.
    if (is_guess) mean.jitter = std::max(mean.jitter, least * least);
    mean.last[1] = mean.last[0];
    mean.last[0] = now;
    mean.num_last = std::min(mean.num_last + 1, 2);
  }
}

/// Takes the joints of a frame into their means in the trunk, measures the correlation of their
/// errors from frame to frame, and takes the intact knee of a person on a seat into its mean.
void TrunkTracker::average_joints(const Skeleton& joints) {
  const Eigen::Quaterniond back = pose_->rotation.conjugate();
  double power = 0.0, product = 0.0, count = 0.0;
  for (const Joint joint : kTrunkJoints) {
    JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (!is_usable(joints, joint)) {
      mean.last_error.setZero();
      continue;
    }
    Eigen::Vector3d place = back * (joints[joint].cast<double>() - pose_->translation);
    if (is_on_pelvis(joint)) place = about_spine(place, -pelvis_.turn);
    // A guess counts as a quarter of a measurement.
    const double trust = joints.state(joint) == TrackingState::kTracked ? 1.0 : 0.25;
    mean.weight = std::min(mean.weight + trust, kWindow);
    if (mean.weight <= trust) mean.place = place;  // the first time
    const Eigen::Vector3d off = place - mean.place;
    const double distance = off.norm();
    if (distance < kContradiction && !mean.last_error.isZero(0.0)) {
      power += off.squaredNorm();
      product += off.dot(mean.last_error);
      count += 1.0;
    }
    mean.last_error = off;
    const double bounded =
        mean.weight > 1.0 && distance > kJointScale ? kJointScale / distance : 1.0;
    mean.place += std::min(1.0, trust / mean.weight) * bounded * off;
  }
  if (!is_arm(affected_)) {
    const auto knee = lap(joints);
    if (!knee) {
      knee_ = {};
    } else {
      const Eigen::Vector3d place = about_spine(back * (*knee - pose_->translation), -pelvis_.turn);
      knee_.weight = std::min(knee_.weight + 1.0, kWindow);
      knee_.place += (place - knee_.place) / knee_.weight;
    }
  }
  if (count == 0.0) return;
  constexpr double kMemory = 0.98;  // from frame to frame
  error_power_ = kMemory * error_power_ + power / count;
  error_product_ = kMemory * error_product_ + product / count;
}

/// Trust of each joint's mean: the variance that an exact mean has in any case over that of this
/// one; 0 for a joint never seen.
TrunkTracker::JointTrust TrunkTracker::joint_trust() const {
  JointTrust trust{};
  for (const Joint joint : kTrunkJoints) {
    const auto i = static_cast<std::size_t>(joint);
    if (joints_[i].weight == 0.0) continue;
    trust[i] = kJointBias * kJointBias / (kJointBias * kJointBias + mean_variance(joints_[i]));
  }
  return trust;
}

/// The means where the trunk is now.
Skeleton TrunkTracker::mean_skeleton(const Pose& pose) const {
  Skeleton skeleton;
  for (const Joint joint : kTrunkJoints) {
    const auto i = static_cast<std::size_t>(joint);
    if (joints_[i].weight == 0.0) continue;
    skeleton.positions[i] = pose(joints_[i].place).cast<float>();
    skeleton.states[i] = TrackingState::kTracked;
  }
  return skeleton;
}

void TrunkTracker::learn(const PersonPoints& points, const DepthView& depth, const PixelRays& rays,
                         const Intrinsics& camera) {
  if (!pose_) return;
  const double half_turn = std::abs(pose_->rotation.dot(key_rotation_));
  const bool fits =
      surface_.size() >= kLeastSurface && surface_share_ > kNewKeyShare && half_turn > kNewKeyTurn;
  if (fits) return;
  // Points of the trunk between the hips and the shoulders, not of what hangs beside it: `half` is
  // half of its width, that of a narrow adult at least. All metres, in the trunk.
  const Eigen::Quaterniond back = pose_->rotation.conjugate();
  double low = 0.0, high = 0.0, half = 0.17;
  for (const Joint joint : kTrunkJoints) {
    const JointMean& mean = joints_[static_cast<std::size_t>(joint)];
    if (mean.weight == 0.0) continue;
    low = std::min(low, mean.place.y());
    high = std::max(high, mean.place.y());
    half = std::max(half, std::abs(mean.place.x()));
  }
  const auto is_candidate = [&](std::size_t i) {
    if (!is_on_trunk(points.label[i])) return false;
    const Eigen::Vector3d place =
        back * (Eigen::Vector3d(points.x[i], points.y[i], points.z[i]) - pose_->translation);
    return place.y() > low - 0.02 && place.y() < high + 0.02 && std::abs(place.x()) < half;
  };
  std::size_t count = 0;
  for (std::int64_t i = 0; i < points.count; ++i) count += is_candidate(i);
  if (count < kLeastSurface) return;  // a frame without depth does not end what is known
  const std::size_t stride = std::max<std::size_t>(1, (count + kMostSurface - 1) / kMostSurface);
  surface_.clear();
  std::size_t seen = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (!is_candidate(i) || seen++ % stride != 0) continue;
    const auto normal = normal_at(depth, rays, points.pixel[i]);
    if (!normal || surface_.size() == kMostSurface) continue;
    const Eigen::Vector3d p(points.x[i], points.y[i], points.z[i]);
    const Eigen::Vector3d place = back * (p - pose_->translation);
    const double loins = (place.y() - low) / std::max(high - low, 0.1);
    const double chest = std::clamp((loins - kLowLoins) / (kHighLoins - kLowLoins), 0.0, 1.0);
    const double share = is_arm(affected_) ? 0.0 : 1.0 - chest;
    const double turn = share * pelvis_.turn;
    surface_.push_back({about_spine(place, -turn), about_spine(back * *normal, -turn), share});
  }
  key_rotation_ = pose_->rotation;
  if (plane_.weight == 0.0) measure_symmetry(depth, rays, camera);
}

}  // namespace manip3d
