#include "manip3d/modify/colliders.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "manip3d/error.hpp"
#include "modify/torso_frame.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kHeadBone = static_cast<std::size_t>(Joint::kHead);
constexpr std::size_t kNumBins = 256;  // of one millimetre each

/// The box between shoulders and hips; `thickness` is the distance of its front and back from the
/// spine.
ColliderBox torso_box(const Skeleton& skeleton, float thickness) {
  using enum Joint;
  const auto axes = torso_frame(skeleton);
  if (!axes || !are_usable(skeleton, {kHipLeft, kHipRight})) return {};
  const Eigen::Vector3f left = axes->col(0);
  const float shoulders = left.dot(skeleton[kShoulderLeft] - skeleton[kShoulderRight]);
  const float hips = left.dot(skeleton[kHipLeft] - skeleton[kHipRight]);
  const Eigen::Vector3f spine = skeleton[kSpineShoulder] - skeleton[kSpineBase];
  ColliderBox box;
  box.centre = skeleton[kSpineBase] + 0.5F * spine;
  box.rotation = Eigen::Quaternionf(*axes);
  box.half_size = {0.5F * std::max(shoulders, hips), 0.5F * spine.norm(), thickness};
  return box;
}

/// Smallest whole number of millimetres within which `share` of the counted distances lie.
float percentile(const std::array<std::uint32_t, kNumBins>& bins, std::uint32_t count,
                 double share) {
  std::uint32_t within = 0;
  for (std::size_t bin = 0; bin < kNumBins; ++bin) {
    within += bins[bin];
    if (static_cast<double>(within) >= share * count) return 0.001F * static_cast<float>(bin);
  }
  return 0.001F * kNumBins;
}

/// Nearest point of the segment from a to b.
Eigen::Vector3d nearest_on(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                           const Eigen::Vector3d& point) {
  const Eigen::Vector3d along = b - a;
  const double length2 = along.squaredNorm();
  const double s = length2 > 0.0 ? std::clamp((point - a).dot(along) / length2, 0.0, 1.0) : 0.0;
  return a + s * along;
}

Eigen::Vector3d between(const Eigen::Vector3f& from, const Eigen::Vector3f& to, double t) {
  return (1.0 - t) * from.cast<double>() + t * to.cast<double>();
}

/// First time in [0, 1] at which a gap is closed that shrinks by at most `speed` per unit of time.
template <typename Gap>
std::optional<double> advance(double speed, const Gap& gap) {
  constexpr double kJump = 1000.0;  // metres; a larger motion in one frame is an error
  if (!(speed <= kJump)) return std::nullopt;
  for (double t = 0.0;;) {
    const double distance = gap(t);
    if (!std::isfinite(distance)) return std::nullopt;
    if (distance <= kTouch) return t;
    if (!(distance < speed * (1.0 - t))) return std::nullopt;  // too far
    t += distance / speed;
  }
}

std::optional<double> time_of_touch(const Capsule& before, const Capsule& now,
                                    const MovingSphere& target) {
  const Eigen::Vector3d velocity = (target.to - target.from).cast<double>();
  const auto relative = [&](const Eigen::Vector3f& from, const Eigen::Vector3f& to) {
    return (velocity - (to - from).cast<double>()).norm();
  };
  // The velocity of each point of the segment is a weighted mean of the velocities of its ends.
  const double speed = std::max(relative(before.start, now.start), relative(before.end, now.end));
  const double reach = static_cast<double>(now.radius) + target.radius;
  return advance(speed, [&](double t) {
    const Eigen::Vector3d centre = between(target.from, target.to, t);
    return (centre - nearest_on(between(before.start, now.start, t),
                                between(before.end, now.end, t), centre))
               .norm() -
           reach;
  });
}

std::optional<double> time_of_touch(const ColliderBox& before, const ColliderBox& now,
                                    const MovingSphere& target) {
  const Eigen::Quaterniond q0 = before.rotation.cast<double>();
  Eigen::Quaterniond q1 = now.rotation.cast<double>();
  if (q0.dot(q1) < 0.0) q1.coeffs() = -q1.coeffs();
  // Normalized linear interpolation of quaternions turns fastest in the middle, at 4 tan(angle / 4)
  // per frame; the dot product of the quaternions is cos(angle / 2).
  const double cosine = std::min(q0.dot(q1), 1.0);
  const double turn = 4.0 * std::sqrt((1.0 - cosine) / (1.0 + cosine));
  const Eigen::Vector3d half = now.half_size.cast<double>();
  const Eigen::Vector3d velocity =
      ((target.to - target.from) - (now.centre - before.centre)).cast<double>();
  const double speed = velocity.norm() + turn * half.norm();
  return advance(speed, [&](double t) {
    const Eigen::Quaterniond rotation(
        Eigen::Vector4d((1.0 - t) * q0.coeffs() + t * q1.coeffs()).normalized());
    const Eigen::Vector3d local = rotation.conjugate() * (between(target.from, target.to, t) -
                                                          between(before.centre, now.centre, t));
    const Eigen::Vector3d outside = (local.cwiseAbs() - half).cwiseMax(0.0);
    return outside.norm() - target.radius;
  });
}

bool exists(const Capsule& capsule) { return capsule.radius > 0.0F; }
bool exists(const ColliderBox& box) { return box.half_size.x() > 0.0F; }

}  // namespace

ColliderTracker::ColliderTracker(const ColliderOptions& options) : options_(options) {
  if (!(options.percentile > 0.0 && options.percentile <= 1.0)) {
    throw InputError("percentile: expected a share above 0 and up to 1, got " +
                     number_text(options.percentile));
  }
  if (options.frames < 1 || options.frames > 1000) {
    throw InputError("frames: expected 1 to 1000, got " + std::to_string(options.frames));
  }
  if (options.min_points < 1) {
    throw InputError("min_points: expected at least 1, got " + std::to_string(options.min_points));
  }
  if (!(options.min_radius > 0.0 && options.min_radius <= options.first_radius &&
        options.first_radius <= options.max_radius && options.max_radius <= 0.25)) {
    throw InputError("radii: expected 0 < min_radius <= first_radius <= max_radius <= 0.25");
  }
  radii_.resize(kNumJoints * static_cast<std::size_t>(options.frames));
}

void ColliderTracker::reset() {
  num_radii_.fill(0);
  now_ = before_ = {};
}

void ColliderTracker::measure(std::span<const std::uint8_t> label,
                              std::span<const float> squared_distance) {
  std::array<std::array<std::uint32_t, kNumBins>, kNumJoints> bins{};
  std::array<std::uint32_t, kNumJoints> count{};
  for (std::size_t i = 0; i < label.size(); ++i) {
    if (label[i] >= kNumJoints || !(squared_distance[i] >= 0.0F)) continue;
    const float millimetres = std::ceil(1000.0F * std::sqrt(squared_distance[i]));
    const float last = kNumBins - 1;
    ++bins[label[i]][std::min(millimetres, last)];
    ++count[label[i]];
  }
  const std::size_t frames = options_.frames;
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    if (count[bone] < static_cast<std::uint32_t>(options_.min_points)) continue;
    const auto slot = static_cast<std::size_t>(num_radii_[bone]++) % frames;
    radii_[bone * frames + slot] = percentile(bins[bone], count[bone], options_.percentile);
  }
}

float ColliderTracker::radius(std::size_t bone) const {
  if (num_radii_[bone] == 0) bone = kMirroredJoints[bone];
  const auto count =
      static_cast<std::size_t>(std::min<std::int64_t>(num_radii_[bone], options_.frames));
  if (count == 0) return static_cast<float>(options_.first_radius);
  const float* of_bone = radii_.data() + bone * static_cast<std::size_t>(options_.frames);
  float sum = 0.0F;
  for (std::size_t i = 0; i < count; ++i) sum += of_bone[i];
  return std::clamp(sum / static_cast<float>(count), static_cast<float>(options_.min_radius),
                    static_cast<float>(options_.max_radius));
}

void ColliderTracker::update(const Skeleton& skeleton, std::span<const std::uint8_t> label,
                             std::span<const float> squared_distance) {
  if (label.size() != squared_distance.size()) {
    throw InputError("label: expected as many as distances (" +
                     std::to_string(squared_distance.size()) + "), got " +
                     std::to_string(label.size()));
  }
  before_ = now_;
  measure(label, squared_distance);
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    const std::size_t parent = kJointParents[bone];
    const bool present = !is_torso_bone(bone) && is_usable(skeleton, static_cast<Joint>(bone)) &&
                         (bone == kHeadBone || is_usable(skeleton, static_cast<Joint>(parent)));
    now_.capsules[bone] = present ? Capsule{skeleton.positions[bone == kHeadBone ? bone : parent],
                                            skeleton.positions[bone], radius(bone)}
                                  : Capsule{};
  }
  constexpr std::size_t kLowerSpine = 1, kUpperSpine = 20;
  now_.torso = torso_box(skeleton, 0.5F * (radius(kLowerSpine) + radius(kUpperSpine)));
}

std::optional<Hit> first_hit(const BodyColliders& before, const BodyColliders& now,
                             const MovingSphere& target) {
  std::optional<Hit> first;
  const auto test = [&](const auto& was, const auto& is, std::size_t bone) {
    if (!exists(is)) return;
    const auto time = time_of_touch(exists(was) ? was : is, is, target);
    if (!time || (first && *time >= first->time)) return;
    const Eigen::Vector3d point = between(target.from, target.to, *time);
    first = Hit{*time, static_cast<std::uint8_t>(bone), point.cast<float>()};
  };
  test(before.torso, now.torso, kTorsoHit);
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    test(before.capsules[bone], now.capsules[bone], bone);
  }
  return first;
}

}  // namespace manip3d
