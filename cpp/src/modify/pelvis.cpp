#include "modify/pelvis.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "geometry/small_solvers.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

constexpr int kPelvisSteps = 4;  // steps are below 0.1 mm from the third on
// kUsualTurn: standard deviation of the pelvis's turn, radians. kTurnChange: of its change in one
// frame, radians. kMove: of a sideways movement, metres. kMinTurn: smallest turn that is used,
// radians. kSureTurn: smallest turn that is used, in standard deviations of its estimate. Chosen on
// seed 5 of `bench_people.py --twist` and on seed 3 of `bench_steadiness.py`.
constexpr double kUsualTurn = 0.2, kTurnChange = 0.04, kMove = 0.03;
constexpr double kMinTurn = 0.05, kSureTurn = 3.0;
constexpr double kPelvisFrame = 1.0 / 30.0;  // seconds that `kTurnChange` refers to
constexpr double kMaxKnee = 90.0;            // frames in the mean of the knee

}  // namespace

/// Normal equations for a small turn of the pelvis about the spine and a translation.
struct Pelvis::Equations {
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  Eigen::Vector4d gradient = Eigen::Vector4d::Zero();
  void add(const Eigen::Vector4d& row, double off, double weight) {
    information += weight * row * row.transpose();
    gradient += weight * off * row;
  }
};

void Pelvis::follow(const Skeleton* joints, const SeenDepth& seen, const KeySurface& surface,
                    const TrunkJoints& means, const TrunkPose& pose, double elapsed) {
  if (is_arm(affected_)) return;
  constexpr double kTurnWeight = 1.0 / (kUsualTurn * kUsualTurn),
                   kMoveWeight = 1.0 / (kMove * kMove);
  const double foreseen = estimated_turn_;
  const double changed = elapsed / kPelvisFrame * kTurnChange * kTurnChange;
  const Eigen::Vector4d prior(1.0 / (variance_ + changed), kMoveWeight, kMoveWeight, kMoveWeight);
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  Equations equations;
  for (int iteration = 0; iteration < kPelvisSteps; ++iteration) {
    equations.information = prior.asDiagonal();
    equations.gradient << prior[0] * (foreseen - estimated_turn_), -kMoveWeight * moved;
    equations.information(0, 0) += kTurnWeight;
    equations.gradient[0] -= kTurnWeight * estimated_turn_;
    add_surface(moved, seen, surface, pose, equations);
    if (joints != nullptr) {
      add_joints(moved, *joints, means, pose, equations);
      add_knee(moved, *joints, means, pose, equations);
    }
    const Eigen::Vector4d step = solve_symmetric(equations.information, equations.gradient);
    estimated_turn_ += step[0];
    moved += step.tail<3>();
  }
  variance_ = equations.information.inverse()(0, 0);
  // Continuous: 0 at the smallest turn that is used, the whole turn from twice that on.
  const double least = std::max(kMinTurn, kSureTurn * std::sqrt(variance_));
  turn_ = estimated_turn_ * std::clamp(std::abs(estimated_turn_) / least - 1.0, 0.0, 1.0);
}

void Pelvis::add_surface(const Eigen::Vector3d& moved, const SeenDepth& seen,
                         const KeySurface& surface, const TrunkPose& pose,
                         Equations& equations) const {
  const double noise = surface.noise();
  const Eigen::Matrix3d rotation = pose.rotation.toRotationMatrix();
  const Eigen::Vector3d centre = pose.translation, spine = rotation.col(1);
  for (const KeySurface::Point& point : surface.points()) {
    if (point.share == 0.0) continue;
    const double turn = point.share * estimated_turn_;
    const Eigen::Vector3d arm = rotation * about_spine(point.place, turn);
    const Eigen::Vector3d normal = rotation * about_spine(point.normal, turn);
    const auto found = seen.residual_at(arm + centre + point.share * moved, normal);
    if (!found) continue;
    Eigen::Vector4d row;
    row << spine.dot(arm.cross(normal)), normal;
    row *= point.share;
    equations.add(row, found->off, found->weight(noise));
  }
}

void Pelvis::add_joints(const Eigen::Vector3d& moved, const Skeleton& joints,
                        const TrunkJoints& means, const TrunkPose& pose,
                        Equations& equations) const {
  const double rho = means.correlation();
  const Eigen::Matrix3d rotation = pose.rotation.toRotationMatrix();
  const Eigen::Vector3d centre = pose.translation + moved, spine = rotation.col(1);
  for (const Joint joint : {Joint::kSpineBase, Joint::kHipLeft, Joint::kHipRight}) {
    if (!means.is_known(joint) || !is_usable(joints, joint)) continue;
    const Eigen::Vector3d arm = rotation * means.place(joint, estimated_turn_);
    const Eigen::Vector3d off =
        joints[joint].cast<double>() - arm - centre - rho * (rotation * means.last_error(joint));
    const Eigen::Vector3d turn = spine.cross(arm);
    const double weight = joint_weight(means.innovation(joint), off.squaredNorm());
    for (int axis = 0; axis < 3; ++axis) {
      Eigen::Vector4d row;
      row << turn[axis], Eigen::Vector3d::Unit(axis);
      equations.add(row, off[axis], weight);
    }
  }
}

void Pelvis::add_knee(const Eigen::Vector3d& moved, const Skeleton& joints,
                      const TrunkJoints& means, const TrunkPose& pose, Equations& equations) const {
  const auto knee = lap(joints, pose);
  if (!knee || knee_frames_ == 0.0) return;
  const double rho = means.correlation();
  const Eigen::Matrix3d rotation = pose.rotation.toRotationMatrix();
  const Eigen::Vector3d centre = pose.translation + moved, spine = rotation.col(1);
  const Eigen::Vector3d arm = rotation * about_spine(knee_, estimated_turn_);
  const Eigen::Vector3d turn = spine.cross(arm), aside = turn.normalized();
  const double off = aside.dot(*knee - centre - arm);
  // The knee is measured as accurately as the hip, but its errors last over frames.
  const double variance = means.innovation(limb_root(opposite(affected_))) / (1.0 - rho * rho);
  Eigen::Vector4d row;
  row << turn.norm(), aside;
  equations.add(row, off, joint_weight(variance, off * off));
}

/// The intact knee of a person on a seat, whose lap hides the pelvis; the thigh turns with the
/// pelvis.
std::optional<Eigen::Vector3d> Pelvis::lap(const Skeleton& joints, const TrunkPose& pose) const {
  constexpr double kMinAhead = 0.25;  // metres from the spine
  const Joint joint = limb_chain(opposite(affected_))[1];
  if (!is_usable(joints, joint) || joints.state(joint) != TrackingState::kTracked) {
    return std::nullopt;
  }
  const Eigen::Vector3d knee = joints[joint].cast<double>();
  const Eigen::Vector3d arm = knee - pose.translation,
                        spine = pose.rotation * Eigen::Vector3d::UnitY();
  if (!((arm - spine.dot(arm) * spine).norm() > kMinAhead)) return std::nullopt;
  return knee;
}

void Pelvis::learn_knee(const Skeleton& joints, const TrunkPose& pose) {
  if (is_arm(affected_)) return;
  const auto knee = lap(joints, pose);
  if (!knee) {
    knee_.setZero();
    knee_frames_ = 0.0;
    return;
  }
  const Eigen::Vector3d place =
      about_spine(pose.rotation.conjugate() * (*knee - pose.translation), -turn_);
  knee_frames_ = std::min(knee_frames_ + 1.0, kMaxKnee);
  knee_ += (place - knee_) / knee_frames_;
}

TrunkPose Pelvis::end_of_limb(const TrunkPose& pose) const {
  if (turn_ == 0.0) return pose;
  const Eigen::Quaterniond turn(1.0, 0.0, 0.5 * turn_, 0.0);
  return {(pose.rotation * turn.normalized()).normalized(), pose.translation};
}

}  // namespace manip3d
