#include "modify/trunk_tracker.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "geometry/constants.hpp"
#include "geometry/small_solvers.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/trunk_axes.hpp"

namespace manip3d {
namespace {

constexpr int kIterations = 4;  // steps fall below 0.1 mm by the third
// Change of the trunk's motion in a frame: radians and metres of the Cauchy prior.
constexpr double kTurnNoise = 0.010, kMoveNoise = 0.006;
constexpr double kStepMemory = 0.7;         // share of the velocity kept from frame to frame
constexpr double kContradictionTime = 0.3;  // seconds until joints are believed
constexpr double kFrameTime = 1.0 / 30.0;   // seconds: of the priors
constexpr double kGap = 0.25;    // seconds without a frame after which the motion is unknown
constexpr double kMissed = 0.1;  // seconds after which the joints say where the surface is

using Matrix6 = Eigen::Matrix<double, 6, 6>;

Eigen::Matrix3d axes_of(const BodyFrame& frame) {
  Eigen::Matrix3d axes;
  axes << frame.n, frame.y, frame.z;
  return axes;
}

}  // namespace

/// For a small turn and move of the pose.
struct TrunkTracker::NormalEquations {
  Matrix6 information = Matrix6::Zero();
  Vector6 gradient = Vector6::Zero();

  /// The trunk is where it was foreseen, by Cauchy weights of what it has moved from there.
  static NormalEquations of_motion(const Vector6& moved, double frames) {
    const double turn_noise = frames * kTurnNoise, move_noise = frames * kMoveNoise;
    const double turn2 = turn_noise * turn_noise + moved.head<3>().squaredNorm();
    const double move2 = move_noise * move_noise + moved.tail<3>().squaredNorm();
    Vector6 prior;
    prior << Eigen::Vector3d::Constant(1.0 / turn2), Eigen::Vector3d::Constant(1.0 / move2);
    return {prior.asDiagonal(), -prior.cwiseProduct(moved)};
  }
};

void TrunkTracker::reset() {
  pose_.reset();
  velocity_.setZero();
  turn_variance_ = 0.0;
  is_contradicted_ = have_leapt_ = are_far_ = false;
  joints_.reset();
  surface_.reset();
  pelvis_.reset();
  plane_.reset();
  across_.reset();
  hips_.reset();
}

/// Begins to follow the trunk at this frame. It is the same person, so the measured errors of the
/// joints are kept; all else is forgotten.
void TrunkTracker::start(const BodyFrame& frame) {
  TrunkJoints joints = joints_;
  joints.forget_places();
  reset();
  joints_ = joints;
  pose_ = TrunkPose{Eigen::Quaterniond(axes_of(frame)), frame.origin};
}

/// Forgets the pose, which tells nothing of where the trunk is after a gap.
void TrunkTracker::end_motion() {
  pose_.reset();
  plane_.forget_covariance();
  joints_.end_motion();
}

std::optional<BodyFrame> TrunkTracker::update(const Skeleton* joints, const DepthView& depth,
                                              const PixelRays& rays, const Intrinsics& camera,
                                              double time_s) {
  const SeenDepth seen(depth, rays, camera);
  const double elapsed = time_s - time_s_, without_joints = time_s - joints_time_s_;
  const bool are_back = joints != nullptr && without_joints > kGap;
  if (pose_ && (elapsed > kGap || are_back)) end_motion();
  const bool jumps = pose_ && joints != nullptr && has_jumped(*joints, std::max(elapsed, 1e-3));
  const bool were_far = are_far_;
  have_moved_ = false;
  if (joints != nullptr) {
    look_for_far_joints(*joints, std::max(without_joints, 1e-3));
    if (are_far_ != were_far) joints_.end_motion();  // the step to other places is not jitter
    joints_.measure_jitter(*joints);
    joints_time_s_ = time_s;
  }
  if (pose_ && joints != nullptr && contradicts()) {
    if (!is_contradicted_) contradicted_since_ = time_s;
    is_contradicted_ = true;
    if (time_s - contradicted_since_ > kContradictionTime) {
      pose_.reset();
      have_moved_ = are_far_;
      if (have_moved_) offset_.setZero();
    }
  } else if (joints != nullptr || !pose_) {  // joints may come less often than images
    is_contradicted_ = false;
  }
  if (pose_) {
    follow(joints, seen, std::max(elapsed, 1e-3), jumps);
  } else if (joints != nullptr) {
    const auto frame = trunk_frame(*joints, affected_, down_);
    if (!frame) return std::nullopt;
    start(*frame);
    joints_.measure_jitter(*joints);
  } else {
    return std::nullopt;
  }
  if (joints != nullptr && !is_contradicted_) {
    joints_.average(*joints, *pose_, pelvis_.turn());
    pelvis_.learn_knee(*joints, *pose_);
  }
  measure_symmetry(seen);
  if (jumps) across_.forget_direction();
  if (joints != nullptr) {
    across_.compare(*joints, joints_, {*pose_, pelvis_.turn()}, frame_at(*pose_), without_joints);
    if (!is_arm(affected_)) {
      hips_.compare(*joints, joints_, pelvis_.end_of_limb(*pose_), pelvis_.turn(), frame(),
                    without_joints);
    }
  }
  time_s_ = time_s;
  return frame();
}

/// One frame on: predicts, fits, and learns the velocity.
void TrunkTracker::follow(const Skeleton* joints, const SeenDepth& seen, double elapsed,
                          bool jumps) {
  const TrunkPose before = *pose_;
  pose_->rotation = (small_turn(elapsed * velocity_.head<3>()) * pose_->rotation).normalized();
  pose_->translation += elapsed * velocity_.tail<3>();
  // A body that turned too far for its surface is looked for as if frames had been missed.
  const double unseen = jumps ? std::max(elapsed, kMissed + kFrameTime) : elapsed;
  const Skeleton* believed = is_contradicted_ ? nullptr : joints;
  fit(believed, seen, unseen);
  pelvis_.follow(believed, seen, surface_, joints_, *pose_, elapsed);
  if (jumps) {  // trackers jump, and a body that did would not go on so
    velocity_.setZero();
    return;
  }
  const Eigen::Quaterniond turn = pose_->rotation * before.rotation.conjugate();
  Vector6 moved;
  moved << (turn.w() < 0.0 ? -2.0 : 2.0) * turn.vec(), pose_->translation - before.translation;
  velocity_ = kStepMemory * velocity_ + (1.0 - kStepMemory) * moved / elapsed;
}

/// Gauss-Newton steps about the predicted pose.
void TrunkTracker::fit(const Skeleton* joints, const SeenDepth& seen, double elapsed) {
  Vector6 moved = Vector6::Zero();
  NormalEquations equations;
  // Motion adds up: what is not foreseen, and how far joints may be from where they were foreseen,
  // grows with time. After frames were missed the joints alone say where the surface is looked for.
  const double frames = std::max(1.0, elapsed / kFrameTime);
  const int alone = joints != nullptr && elapsed > kMissed ? 2 : 0;
  KeySurface::Agreement agreed;
  for (int iteration = -alone; iteration < kIterations; ++iteration) {
    equations = NormalEquations::of_motion(moved, frames);
    if (iteration >= 0) agreed = add_surface(seen, equations);
    if (iteration + 1 == kIterations) surface_.learn(agreed);
    if (joints != nullptr) add_joints(*joints, frames * kJointScale, equations);
    const Vector6 step = solve_symmetric(equations.information, equations.gradient);
    moved += step;
    pose_->rotation = (small_turn(step.head<3>()) * pose_->rotation).normalized();
    pose_->translation += step.tail<3>();
  }
  const Matrix6 covariance = invert_symmetric(equations.information);
  turn_variance_ = covariance.topLeftCorner<3, 3>().trace() / 3.0;
}

/// The points of the key frame lie on the surface that is seen now.
KeySurface::Agreement TrunkTracker::add_surface(const SeenDepth& seen,
                                                NormalEquations& equations) const {
  const double noise = surface_.noise();
  const Eigen::Vector3d centre = pose_->translation;
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  KeySurface::Agreement agreed;
  for (const KeySurface::Point& point : surface_.points()) {
    const double turn = point.share * pelvis_.turn();
    const Eigen::Vector3d p = rotation * about_spine(point.place, turn) + centre;
    const Eigen::Vector3d normal = rotation * about_spine(point.normal, turn);
    const auto found = seen.residual_at(p, normal);
    if (!found) continue;
    if (found->agrees()) {
      ++agreed.points;
      agreed.off += std::abs(found->off);
    }
    const double weight = found->weight(noise);
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
  const double rho = joints_.correlation();
  const Eigen::Vector3d centre = pose_->translation;
  const Eigen::Matrix3d rotation = pose_->rotation.toRotationMatrix();
  for (const Joint joint : kTrunkJoints) {
    if (!joints_.is_known(joint) || !is_usable(joints, joint)) continue;
    const Eigen::Vector3d arm = rotation * joints_.place(joint, pelvis_.turn());
    const Eigen::Vector3d whole = joints[joint].cast<double>() - arm - centre;
    // Errors that drift are known from the last frame but for what is new of them.
    const Eigen::Vector3d off = whole - rho * (rotation * joints_.last_error(joint));
    const double weight = joint_weight(joints_.innovation(joint), off.squaredNorm(), scale);
    Eigen::Matrix<double, 3, 6> rows;
    rows << 0.0, arm.z(), -arm.y(), 1.0, 0.0, 0.0,  //
        -arm.z(), 0.0, arm.x(), 0.0, 1.0, 0.0,      //
        arm.y(), -arm.x(), 0.0, 0.0, 0.0, 1.0;
    equations.information += weight * rows.transpose() * rows;
    equations.gradient += weight * rows.transpose() * off;
  }
}

std::optional<BodyFrame> TrunkTracker::frame() const {
  if (!pose_) return std::nullopt;
  return frame_at(pelvis_.end_of_limb(*pose_));
}

/// The axes of the joints' means.
std::optional<BodyFrame> TrunkTracker::joint_axes(const TrunkPose& pose) const {
  return trunk_frame(joints_.skeleton(pose), affected_, joints_.trust(), down_);
}

/// The axes of the joints' means, with the plane that the surface shows.
std::optional<BodyFrame> TrunkTracker::frame_at(const TrunkPose& pose) const {
  const auto axes = joint_axes(pose);
  if (!axes) return std::nullopt;
  return plane_.move(*axes, pose);
}

void TrunkTracker::measure_symmetry(const SeenDepth& seen) {
  const auto axes = joint_axes(*pose_);
  if (!axes) return;
  const SymmetryPlane::Prior prior{
      *axes, joints_.plane_variance(axes->n, affected_, down_covariance_), offset_along(axes->n)};
  plane_.measure(prior, surface_, *pose_, pelvis_.turn(), seen);
}

/// Offset between the flesh of the trunk and its joints in a direction, metres. It is that of the
/// limbs if that offset exceeds the errors of their own joints. The weight's power of four was
/// chosen on the tuning half of benchmarks/bench_people.py, whose limbs lie up to 3.2 cm aside.
double TrunkTracker::offset_along(const Eigen::Vector3d& n) const {
  const double off = offset_.dot(n), ratio = off * off / (kJointBias * kJointBias);
  return off * ratio * ratio / (1.0 + ratio * ratio);
}

double TrunkTracker::deviation_deg() const {
  if (!plane_.covariance()) return kInfinity;
  const Eigen::Matrix3d& plane = *plane_.covariance();
  const double known = std::sqrt(turn_variance_ + plane(0, 0) + plane(1, 1));
  const double turned = std::max(across_.disagreement(), hips_.twist());
  return std::hypot(1.0 / kDegree * known, turned / kDegree);
}

double TrunkTracker::deviation_at(const Eigen::Vector3d& p, const BodyFrame& frame) const {
  const Eigen::Vector3d from = p - frame.origin;
  const Eigen::Vector3d row(frame.y.dot(from), frame.z.dot(from), -1.0);
  const double within = plane_.covariance() ? row.dot(*plane_.covariance() * row) : 0.0;
  return std::sqrt(within + turn_variance_ * row.head<2>().squaredNorm());
}

/// Are most joints far from where they are in the trunk, or have all leapt aside and not come back?
void TrunkTracker::look_for_far_joints(const Skeleton& joints, double elapsed) {
  // Metres in a frame beyond the foreseen step; people do not start to move at 3 metres a second.
  // In one trial of the tuning half the joints leap as far, while the person's pixels stay.
  constexpr double kLeap = 0.10;
  constexpr double kStillFar = 0.05;  // metres
  are_far_ = false;
  if (!pose_) return;
  const Eigen::Vector3d step = joints_.mean_step(joints) - elapsed * velocity_.tail<3>();
  have_leapt_ = (have_leapt_ || step.norm() > kLeap * std::max(1.0, elapsed / kFrameTime)) &&
                joints_.are_far(joints, *pose_, pelvis_.turn(), kStillFar);
  are_far_ = have_leapt_ || joints_.are_far(joints, *pose_, pelvis_.turn());
}

/// Are most joints far from where they are in the trunk, is the plane turned against them, or is
/// the pelvis turned against the hips?
bool TrunkTracker::contradicts() const {
  return are_far_ || across_.disagreement() > 0.0 || hips_.is_against_turn();
}

bool TrunkTracker::has_jumped(const Skeleton& joints, double elapsed) const {
  const Eigen::Quaterniond foreseen = small_turn(elapsed * velocity_.head<3>()) * pose_->rotation;
  return across_.has_jumped(joints, joints_, {*pose_, pelvis_.turn()}, foreseen);
}

void TrunkTracker::learn(const PersonPoints& points, const DepthView& depth, const PixelRays& rays,
                         const Intrinsics& camera) {
  if (!pose_ || !surface_.is_outdated(*pose_)) return;
  const SeenDepth seen(depth, rays, camera);
  const bool is_renewed =
      surface_.renew(points, seen, *pose_, joints_.extent(), is_arm(affected_), pelvis_.turn());
  if (is_renewed && !plane_.is_measured()) measure_symmetry(seen);
}

}  // namespace manip3d
