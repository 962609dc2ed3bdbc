#include "modify/trunk_turns.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "geometry/constants.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/trunk_axes.hpp"

namespace manip3d {
namespace {

using enum Joint;

// kAcrossTime: seconds over which the direction across the trunk is averaged. kMaxDisagreement:
// its largest angle to the plane's normal, radians; a reaching arm moves its shoulder by up to 10
// cm.
constexpr double kAcrossTime = 0.1, kMaxDisagreement = 0.26;
// A direction across has jumped if it turns by more than kMaxJump, radians, and more than
// kSureJump standard deviations of its jitter from one frame to the next.
constexpr double kMaxJump = 0.21, kSureJump = 4.0;
// kHipsTime: seconds over which the direction of the hips is averaged. kUsualTime: seconds over
// which its angle to the plane is averaged. kMaxTwist: largest deviation from that angle, radians,
// beyond one and a half standard deviations of its errors. kFirstUsual: seconds for which an angle
// of 0 counts at the start. Chosen on seed 0 of `bench_people.py --twist` and on the tuning half of
// the recorded people.
constexpr double kHipsTime = 0.2, kUsualTime = 10.0, kMaxTwist = 0.10, kFirstUsual = 3.0;
// Angle of the hips to the plane, radians, beyond one and a half standard deviations of its errors,
// from which on a turn of the pelvis that increases it is wrong.
constexpr double kMaxAgainstTurn = 0.14;
constexpr double kLongestStep = 0.25;      // seconds
constexpr double kTurnFrame = 1.0 / 30.0;  // seconds

bool are_tracked(const Skeleton& joints, Joint left, Joint right) {
  return std::ranges::all_of(std::array{left, right}, [&](Joint joint) {
    return is_usable(joints, joint) && joints.state(joint) == TrackingState::kTracked;
  });
}

struct Across {  // In the camera frame.
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  double jitter = 0.0;  // Standard deviation of the direction in one frame, radians.
};

/// Direction from right to left: that of the shoulders plus half of that of the hips; a pair is
/// used only if both joints are tracked.
std::optional<Across> tracked_across(const Skeleton& joints, const TrunkJoints& means,
                                     const TwistedPose& pose) {
  Across across;
  double length = 0.0, variance = 0.0;
  const auto add = [&](Joint left, Joint right, double share, double width) {
    if (!are_tracked(joints, left, right)) return;
    Eigen::Vector3d direction = (joints[left] - joints[right]).cast<double>();
    if (is_on_pelvis(left) && pose.pelvis_turn != 0.0) {
      const Eigen::Quaterniond& rotation = pose.trunk.rotation;
      direction = rotation * about_spine(rotation.conjugate() * direction, -pose.pelvis_turn);
    }
    across.direction += share * direction;
    length += share * width;
    for (const Joint joint : {left, right}) variance += share * share * means.jitter(joint);
  };
  add(kShoulderLeft, kShoulderRight, 1.0, kAdultShoulders);
  add(kHipLeft, kHipRight, kOtherPair, kAdultHips);
  if (across.direction.isZero(0.0)) return std::nullopt;
  across.jitter = std::sqrt(variance) / length;
  return across;
}

}  // namespace

bool AcrossCheck::has_jumped(const Skeleton& joints, const TrunkJoints& means,
                             const TwistedPose& pose, const Eigen::Quaterniond& foreseen) const {
  const auto across = tracked_across(joints, means, pose);
  if (!across || across_.isZero(0.0)) return false;
  const Eigen::Vector3d before = foreseen * across_;
  const double cosine = before.dot(across->direction);
  const double turn = std::atan2(before.cross(across->direction).norm(), cosine);
  return turn > std::max(kMaxJump, kSureJump * across->jitter) &&
         means.off_as_a_whole(joints, pose.pelvis_turn) < kJointScale;
}

void AcrossCheck::compare(const Skeleton& joints, const TrunkJoints& means, const TwistedPose& pose,
                          const std::optional<BodyFrame>& axes, double elapsed) {
  disagreement_ = 0.0;
  if (!axes) return;
  const auto across = tracked_across(joints, means, pose);
  if (!across) {
    across_.setZero();
    return;
  }
  const Eigen::Vector3d within = pose.trunk.rotation.conjugate() * across->direction;
  const double gain = across_.isZero(0.0) ? 1.0 : 1.0 - std::exp(-elapsed / kAcrossTime);
  across_ += gain * (within - across_);
  const Eigen::Vector3d mean = pose.trunk.rotation * across_;
  const double turn = std::abs(std::atan2(axes->z.dot(mean), axes->n.dot(mean)));
  // The share of the variance of white noise that remains in an exponential mean at 30 frames a
  // second: a / (2 - a) with a = 1 - e^(-1/3).
  constexpr double kLeft = 0.165;
  const double deviation = std::sqrt(kLeft) * across->jitter;
  if (turn > kMaxDisagreement + 2.0 * deviation) disagreement_ = turn;
}

void HipCheck::reset() {
  hips_.setZero();
  usual_angle_ = twist_ = 0.0;
  usual_time_ = kFirstUsual;
  is_against_turn_ = false;
}

void HipCheck::compare(const Skeleton& joints, const TrunkJoints& means, const TrunkPose& end,
                       double pelvis_turn, const std::optional<BodyFrame>& axes, double elapsed) {
  twist_ = 0.0;
  is_against_turn_ = false;
  if (!axes) return;
  if (!are_tracked(joints, kHipLeft, kHipRight)) {
    hips_.setZero();
    return;
  }
  const Eigen::Vector3d across = (joints[kHipLeft] - joints[kHipRight]).cast<double>();
  const double step = std::clamp(elapsed, 1e-3, kLongestStep);
  const double gain = hips_.isZero(0.0) ? 1.0 : 1.0 - std::exp(-step / kHipsTime);
  hips_ += gain * (end.rotation.conjugate() * across - hips_);
  const Eigen::Vector3d mean = end.rotation * hips_;
  const double z = axes->z.dot(mean), n = axes->n.dot(mean), angle = std::atan2(z, n);
  usual_time_ = std::min(usual_time_ + step, kUsualTime);
  usual_angle_ += step / usual_time_ * std::remainder(angle - usual_angle_, kFullTurn);
  // The variance of an exponential mean of first-order autoregressive errors. The innovation
  // divided by 1 - rho^2 is the variance of the errors. A mean that keeps `kept` of itself from
  // frame to frame has (1 - kept) / (1 + kept) (1 + rho kept) / (1 - rho kept) of that variance.
  const double rho = means.correlation(), kept = std::exp(-kTurnFrame / kHipsTime);
  const double variance =
      (means.innovation(kHipLeft) + means.innovation(kHipRight)) *
      ((1.0 - kept) / (1.0 + kept) * (1.0 + rho * kept) / (1.0 - rho * kept) / (1.0 - rho * rho));
  const double turn = std::abs(std::remainder(angle - usual_angle_, kFullTurn));
  const double doubt = 1.5 * std::sqrt(variance) / std::hypot(z, n);
  if (turn > kMaxTwist + doubt) twist_ = turn;
  // The means of the hips contain the pelvis's turn, so that a wrong one that lasts agrees with
  // them and becomes the usual angle. Without the turn the angle would be `angle - pelvis_turn`.
  const double off = std::abs(angle);
  is_against_turn_ = off > kMaxAgainstTurn + doubt &&
                     std::abs(std::remainder(angle - pelvis_turn, kFullTurn)) < off;
  if (is_against_turn_) twist_ = std::max(twist_, off);
}

}  // namespace manip3d
