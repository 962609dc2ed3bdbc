#include "modify/trunk_joints.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <tuple>

#include "geometry/constants.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

using enum Joint;

constexpr double kMaxFrames = 90.0;   // frames over which joints are averaged
constexpr double kFirstErrors = 5.0;  // frames as which the initial correlation counts
// Bounds of the measured jitter of a joint of the trunk, metres. Errors below 1 cm exist, but
// change so slowly that they are not measured as jitter.
constexpr double kMinNoise = 0.01, kMaxNoise = 0.08;
constexpr double kFirstJitter = 0.005,
                 kGuessed = 5.0;  // metres, before it is measured; factor for inferred joints
// Correlation of a joint's errors from frame to frame until it is measured. It is high, because
// trackers filter.
constexpr double kFirstCorrelation = 0.8, kMaxCorrelation = 0.95;
// Standard deviation of the plane of the joints: roll and yaw in radians, offset in metres.
const Eigen::Vector3d kPlaneBias(0.03, 0.04, 0.012);
constexpr double kLegRoll = 0.005;  // a leaning trunk hardly changes the roll of the pelvis
constexpr double kUnknown = 0.04;   // square metres; variance of a joint that was never seen

/// Variance of the vertical along the normal of a leg's plane, square radians. Continuous: 0 up to
/// a standard deviation of one degree, which remains even for level cameras, and the whole variance
/// from two degrees on.
double level_variance(const Eigen::Vector3d& n, const Eigen::Matrix3d& down_covariance) {
  const double variance = std::max(0.0, n.dot(down_covariance * n));
  return variance * std::clamp(std::sqrt(variance) / kDegree - 1.0, 0.0, 1.0);
}

}  // namespace

double joint_weight(double variance, double squared_off, double scale) {
  const double noise = std::clamp(std::sqrt(variance), kMinNoise, kMaxNoise);
  return 1.0 / (noise * noise * (1.0 + squared_off / (scale * scale)));
}

void TrunkJoints::reset() {
  means_ = {};
  error_power_ = kFirstErrors * kFirstJitter * kFirstJitter;
  error_product_ = kFirstCorrelation * error_power_;
}

void TrunkJoints::forget_places() {
  for (Mean& mean : means_) {
    const double jitter = mean.jitter;
    mean = {};
    mean.jitter = jitter;
  }
}

void TrunkJoints::end_motion() {
  for (Mean& mean : means_) mean.num_last = 0;
}

void TrunkJoints::measure_jitter(const Skeleton& joints) {
  for (const Joint joint : kTrunkJoints) {
    Mean& mean = of(joint);
    if (!is_usable(joints, joint)) {
      mean.num_last = 0;
      continue;
    }
    const bool is_guess = joints.state(joint) != TrackingState::kTracked;
    const double least = kFirstJitter * (is_guess ? kGuessed : 1.0);
    const Eigen::Vector3d now = joints[joint].cast<double>();
    if (mean.jitter == 0.0) mean.jitter = least * least;
    if (mean.num_last == 2) {
      constexpr double kMost = 0.1;    // metres; larger jumps are not jitter
      constexpr double kMemory = 0.9;  // weight of the previous value
      const Eigen::Vector3d second = now - 2.0 * mean.last[0] + mean.last[1];
      // White noise of variance s has second differences of variance 6 s in each coordinate.
      const double seen = std::min(second.squaredNorm(), 18.0 * kMost * kMost) / 18.0;
      mean.jitter = kMemory * mean.jitter + (1.0 - kMemory) * seen;
    }
    // An inferred joint may stand still without being accurate.
    if (is_guess) mean.jitter = std::max(mean.jitter, least * least);
    mean.last[1] = mean.last[0];
    mean.last[0] = now;
    mean.num_last = std::min(mean.num_last + 1, 2);
  }
}

void TrunkJoints::average(const Skeleton& joints, const TrunkPose& pose, double pelvis_turn) {
  const Eigen::Quaterniond back = pose.rotation.conjugate();
  double power = 0.0, product = 0.0, count = 0.0;
  for (const Joint joint : kTrunkJoints) {
    Mean& mean = of(joint);
    if (!is_usable(joints, joint)) {
      mean.last_error.setZero();
      continue;
    }
    const Eigen::Vector3d place =
        with_pelvis(back * (joints[joint].cast<double>() - pose.translation), joint, -pelvis_turn);
    // An inferred joint has a quarter of the weight of a tracked one.
    const double trust = joints.state(joint) == TrackingState::kTracked ? 1.0 : 0.25;
    mean.weight = std::min(mean.weight + trust, kMaxFrames);
    if (mean.weight <= trust) mean.place = place;  // first measurement
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
  if (count == 0.0) return;
  constexpr double kMemory = 0.98;  // weight of the previous sums
  error_power_ = kMemory * error_power_ + power / count;
  error_product_ = kMemory * error_product_ + product / count;
}

Skeleton TrunkJoints::skeleton(const TrunkPose& pose) const {
  Skeleton skeleton;
  for (const Joint joint : kTrunkJoints) {
    if (!is_known(joint)) continue;
    const auto i = static_cast<std::size_t>(joint);
    skeleton.positions[i] = pose(means_[i].place).cast<float>();
    skeleton.states[i] = TrackingState::kTracked;
  }
  return skeleton;
}

KeySurface::Extent TrunkJoints::extent() const {
  KeySurface::Extent extent;
  for (const Joint joint : kTrunkJoints) {
    if (!is_known(joint)) continue;
    const Eigen::Vector3d& place = of(joint).place;
    extent.low = std::min(extent.low, place.y());
    extent.high = std::max(extent.high, place.y());
    extent.half = std::max(extent.half, std::abs(place.x()));
  }
  return extent;
}

double TrunkJoints::correlation() const {
  return std::clamp(error_product_ / error_power_, 0.0, kMaxCorrelation);
}

// Errors of variance s with correlation rho have second differences of variance 2 s (1 - rho) (3 -
// rho), which is six times `jitter`; the innovation has the variance s (1 - rho^2).
double TrunkJoints::innovation(Joint joint) const {
  const double rho = correlation();
  return of(joint).jitter * 3.0 * (1.0 + rho) / (3.0 - rho);
}

/// The variance of a joint's mean, for correlated errors. The correlation is uncertain at first; it
/// is then taken as the largest possible one, because joints with lasting errors would otherwise
/// outweigh the surface.
double TrunkJoints::mean_variance(Joint joint) const {
  constexpr double kUnsure = 8.0, kMost = 50.0;  // frames; the running sums remember kMost
  const double weight = of(joint).weight, doubt = kUnsure / std::clamp(weight, kUnsure, kMost);
  const double rho = doubt * kMaxCorrelation + (1.0 - doubt) * correlation();
  const double frames = 1.0 + std::max(0.0, weight - 1.0) * (1.0 - rho) / (1.0 + rho);
  return innovation(joint) / ((1.0 - rho * rho) * frames);
}

JointTrust TrunkJoints::trust() const {
  JointTrust trust{};
  for (const Joint joint : kTrunkJoints) {
    if (!is_known(joint)) continue;
    trust[static_cast<std::size_t>(joint)] =
        kJointBias * kJointBias / (kJointBias * kJointBias + mean_variance(joint));
  }
  return trust;
}

double TrunkJoints::size_against_adult() const {
  constexpr double kLeast = 0.4;  // share of an adult; joints that are closer together are wrong
  constexpr std::array<std::tuple<Joint, Joint, double>, 2> kLengths = {
      {{kShoulderLeft, kShoulderRight, kAdultShoulders},
       {kSpineBase, kSpineShoulder, 0.535}}};  // metres
  double sum = 0.0, adult = 0.0;
  for (const auto& [from, to, length] : kLengths) {
    if (!is_known(from) || !is_known(to)) continue;
    sum += (of(from).place - of(to).place).norm();
    adult += length;
  }
  return adult > 0.0 ? std::clamp(sum / adult, kLeast, 1.0) : 1.0;
}

Eigen::Vector3d TrunkJoints::plane_variance(const Eigen::Vector3d& n, Limb limb,
                                            const Eigen::Matrix3d& down_covariance) const {
  const auto variance = [&](Joint joint) {
    return is_known(joint) ? mean_variance(joint) : kUnknown;
  };
  const JointTrust trusted = trust();
  // Yaw: variance of the mean of the directions of both pairs, weighted by trust, divided by its
  // squared length.
  const double size = size_against_adult();
  const bool arm = is_arm(limb);
  const auto pair_trust = [&](Joint left, Joint right) {
    return std::min(trust_of(trusted, left), trust_of(trusted, right));
  };
  const double a = (arm ? 1.0 : kOtherPair) * pair_trust(kShoulderLeft, kShoulderRight);
  const double b = (arm ? kOtherPair : 1.0) * pair_trust(kHipLeft, kHipRight);
  const double length = std::max(size * (a * kAdultShoulders + b * kAdultHips), 1e-3);
  const double yaw = (a * a * (variance(kShoulderLeft) + variance(kShoulderRight)) +
                      b * b * (variance(kHipLeft) + variance(kHipRight))) /
                     (length * length);
  // Roll: variance of the slope of a line through the middle joints.
  constexpr double kSpine = 0.25;  // metres; standard deviation of their heights
  double precision = 0.0;
  for (const Joint joint : kSpineJoints) precision += 1.0 / (variance(joint) + 1e-6);
  // Errors of joints do not scale with the body, so they turn the axes of a small body by more.
  Eigen::Vector3d bias(kPlaneBias[0] / size, kPlaneBias[1] / size, kPlaneBias[2]);
  double roll = 1.0 / (precision * size * size * kSpine * kSpine);
  if (!arm) {
    bias[0] = kLegRoll;
    roll *= kLeftTilt * kLeftTilt;
    roll += (1.0 - kLeftTilt) * (1.0 - kLeftTilt) * level_variance(n, down_covariance);
  }
  return bias.cwiseProduct(bias) + Eigen::Vector3d(roll, yaw, 1.0 / precision);
}

Eigen::Vector3d TrunkJoints::mean_step(const Skeleton& joints) const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int count = 0;
  for (const Joint joint : kTrunkJoints) {
    if (of(joint).num_last == 0 || !is_usable(joints, joint)) continue;
    sum += joints[joint].cast<double>() - of(joint).last[0];
    ++count;
  }
  return sum / std::max(count, 1);
}

bool TrunkJoints::are_far(const Skeleton& joints, const TrunkPose& pose, double pelvis_turn,
                          double limit) const {
  int off = 0, all = 0;
  for (const Joint joint : kTrunkJoints) {
    if (!is_known(joint) || !is_usable(joints, joint)) continue;
    ++all;
    const Eigen::Vector3d expected = pose(place(joint, pelvis_turn));
    if ((joints[joint].cast<double>() - expected).norm() > limit) ++off;
  }
  return 2 * off > all;
}

double TrunkJoints::off_as_a_whole(const Skeleton& joints, double pelvis_turn) const {
  std::array<Eigen::Vector3d, kTrunkJoints.size()> places, measured;
  std::size_t count = 0;
  Eigen::Vector3d place_sum = Eigen::Vector3d::Zero(), measured_sum = Eigen::Vector3d::Zero();
  for (const Joint joint : kTrunkJoints) {
    if (!is_known(joint) || !is_usable(joints, joint)) continue;
    if (joints.state(joint) != TrackingState::kTracked) continue;
    place_sum += places[count] = place(joint, pelvis_turn);
    measured_sum += measured[count] = joints[joint].cast<double>();
    ++count;
  }
  if (count == 0) return 0.0;
  const auto n = static_cast<double>(count);
  const Eigen::Vector3d place_mean = place_sum / n, measured_mean = measured_sum / n;
  Eigen::Matrix3d products = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    products += (measured[i] - measured_mean) * (places[i] - place_mean).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(products, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d u = svd.matrixU(), v = svd.matrixV();
  const Eigen::Vector3d hand(1.0, 1.0, (u * v.transpose()).determinant() < 0.0 ? -1.0 : 1.0);
  const Eigen::Matrix3d rotation = u * hand.asDiagonal() * v.transpose();
  double off = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    off += (measured[i] - measured_mean - rotation * (places[i] - place_mean)).norm();
  }
  return off / n;
}

}  // namespace manip3d
