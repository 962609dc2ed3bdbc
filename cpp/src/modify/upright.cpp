#include "modify/upright.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <optional>

#include "geometry/constants.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

constexpr double kRollStep = 2.0, kPitchStep = 5.0;  // degrees of the grid
// The prior: shares of cameras without roll and without pitch, and the standard deviations of the
// others.
constexpr double kLevelCameras = 0.95, kPlainCameras = 0.5;
constexpr double kRolled = 12.0, kPitched = 15.0;  // degrees
constexpr double kPose = 2.0;      // seconds that a pose lasts; one pose counts as one measurement
constexpr double kMaxPoses = 2.0;  // no more poses count, because errors of trackers last longer
// Seconds: of the mean, and between two frames that are used.
constexpr double kMemory = 10.0, kEvery = 0.1;
constexpr double kStraight = 0.94;  // cosine of 20 degrees at a knee; a straighter leg is one axis
// Radians. The tilts of 95 % of the tuning half of benchmarks/bench_people.py, whose camera is
// level, are smaller.
constexpr double kMinTilt = 2.5 * kDegree;

/// An axis of the body that is upright in most poses, and its usual deviation in degrees.
struct Axis {
  Eigen::Vector3d down;
  double aside = 0.0, ahead = 0.0;
};

std::optional<Eigen::Vector3d> direction(const Skeleton& person, Joint from, Joint to) {
  constexpr float kShort = 0.1F;  // metres
  for (const Joint joint : {from, to}) {
    if (!is_usable(person, joint) || person.state(joint) != TrackingState::kTracked) return {};
  }
  const Eigen::Vector3f along = person[to] - person[from];
  if (!(along.norm() > kShort)) return {};
  return along.cast<double>().normalized();
}

std::optional<Axis> spine_of(const Skeleton& person) {
  const auto spine = direction(person, Joint::kSpineShoulder, Joint::kSpineBase);
  if (!spine) return {};
  return Axis{*spine, 2.0, 8.0};
}

/// The leg of the side on which no limb is affected. The other leg of a person with an affected arm
/// is not used: both legs share the pose and its errors.
Limb intact_leg(Limb affected) {
  const Limb intact = opposite(affected);
  return intact == Limb::kLeftArm || intact == Limb::kLeftLeg ? Limb::kLeftLeg : Limb::kRightLeg;
}

std::optional<Axis> leg_of(const Skeleton& person, Limb leg) {
  const auto chain = limb_chain(leg);
  const auto thigh = direction(person, chain[0], chain[1]);
  const auto shin = direction(person, chain[1], chain[2]);
  if (!thigh || !shin) return {};
  if (thigh->dot(*shin) < kStraight) return Axis{*shin, 6.0, 15.0};
  const auto whole = direction(person, chain[0], chain[2]);
  if (!whole) return {};
  return Axis{*whole, 3.0, 8.0};
}

Eigen::Vector3d down_at(double roll_deg, double pitch_deg) {
  const double r = roll_deg * kDegree, p = pitch_deg * kDegree;
  return {-std::sin(r) * std::cos(p), std::cos(r) * std::cos(p), std::sin(p)};
}

/// Prior probability of a cell of the grid for one angle.
double prior_of(double angle, double level, double deviation, double step) {
  constexpr double kRootOfTwoPi = 2.5066282746310002;
  const double x = angle / deviation;
  const double others = (1.0 - level) * step / (kRootOfTwoPi * deviation) * std::exp(-0.5 * x * x);
  return others + (angle == 0.0 ? level : 0.0);
}

/// A possible tilt of the camera: a cell of the grid.
struct Tilt {
  Eigen::Vector3d down;
  double prior = 0.0;
};

using Tilts = std::array<Tilt, Upright::kRolls * Upright::kPitches>;

Tilts all_tilts() {
  constexpr std::size_t kRolls = Upright::kRolls, kPitches = Upright::kPitches;
  Tilts tilts;
  for (std::size_t cell = 0; cell < tilts.size(); ++cell) {
    const auto i = static_cast<double>(cell / kPitches), j = static_cast<double>(cell % kPitches);
    const double roll = kRollStep * (i - 0.5 * (kRolls - 1.0));
    const double pitch = kPitchStep * (j - 0.5 * (kPitches - 1.0));
    tilts[cell] = {down_at(roll, pitch), prior_of(roll, kLevelCameras, kRolled, kRollStep) *
                                             prior_of(pitch, kPlainCameras, kPitched, kPitchStep)};
  }
  return tilts;
}

const Tilts& tilts_of_grid() {
  static const Tilts kTilts = all_tilts();
  return kTilts;
}

}  // namespace

void Upright::learn(const Skeleton& person, Limb affected, double time_s) {
  const double elapsed = time_s - time_s_;
  if (seconds_ > 0.0 && elapsed < kEvery) return;
  const auto spine = spine_of(person);
  const auto left = direction(person, Joint::kShoulderRight, Joint::kShoulderLeft);
  if (!spine || !left) return;
  time_s_ = time_s;
  const Eigen::Vector3d aside = (*left - left->dot(spine->down) * spine->down).normalized();
  const auto leg = leg_of(person, intact_leg(affected));
  const double step = seconds_ > 0.0 ? std::min(elapsed, kPose) : kPose;
  seconds_ = std::min(seconds_ + step, kMemory);
  const double gain = step / seconds_;
  const auto& tilts = tilts_of_grid();
  for (std::size_t cell = 0; cell < log_likelihood_.size(); ++cell) {
    double log_likelihood = 0.0;
    for (const auto& axis : {spine, leg}) {
      if (!axis) continue;
      // Student's t distribution with three degrees of freedom, in two dimensions.
      const Eigen::Vector3d off = (axis->down - tilts[cell].down) / kDegree;
      const double x = off.dot(aside), y2 = std::max(0.0, off.squaredNorm() - x * x);
      const double q = x * x / (axis->aside * axis->aside) + y2 / (axis->ahead * axis->ahead);
      log_likelihood -= 2.5 * std::log1p(q / 3.0);
    }
    log_likelihood_[cell] += gain * (log_likelihood - log_likelihood_[cell]);
  }
  weigh();
}

/// Computes the mean and the covariance of the vertical over all rolls and pitches.
void Upright::weigh() {
  const double poses = std::min(seconds_ / kPose, kMaxPoses);
  const double most = *std::ranges::max_element(log_likelihood_);
  const auto& tilts = tilts_of_grid();
  double sum = 0.0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
  for (std::size_t cell = 0; cell < log_likelihood_.size(); ++cell) {
    const auto& [down, prior] = tilts[cell];
    const double weight = prior * std::exp(poses * (log_likelihood_[cell] - most));
    sum += weight;
    mean += weight * down;
    squares += weight * down * down.transpose();
  }
  mean /= sum;
  covariance_ = squares / sum - mean * mean.transpose();
  // Continuous: no tilt up to kMinTilt, the whole tilt from twice that on.
  const double share = std::clamp(std::hypot(mean.x(), mean.z()) / kMinTilt - 1.0, 0.0, 1.0);
  down_ = Eigen::Vector3d(share * mean.x(), mean.y(), share * mean.z()).normalized();
}

}  // namespace manip3d
