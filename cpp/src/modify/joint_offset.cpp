#include "modify/joint_offset.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "manip3d/modify/joint_smoother.hpp"
#include "modify/bone_direction.hpp"

namespace manip3d {
namespace {

// Metres. Chosen on the tuning half of benchmarks/bench_people.py. The mean over the limbs of a
// trial is at most 3.2 cm beside the bones while it runs; the points are 3 to 7 cm in front of the
// bones.
constexpr double kMaxAcross = 0.045;
constexpr double kMaxBehind = 0.03;   // 0 for trackers whose joints are on the skin
constexpr double kMaxBefore = -0.16;  // stout people in thick clothes
constexpr double kFewFrames = 1.0;
constexpr float kFarthestFlesh = 0.35F;  // metres; points farther from a bone do not belong to it

/// The bones of a person's limbs, without the affected limb.
struct LimbBones {
  std::array<bool, kNumJoints> tells{};
  std::array<Eigen::Vector3f, kNumJoints> start, along;

  LimbBones(const Skeleton& person, Limb affected) {
    for (const Limb limb : {Limb::kLeftArm, Limb::kRightArm, Limb::kLeftLeg, Limb::kRightLeg}) {
      if (limb == affected) continue;
      for (const Joint joint : limb_chain(limb).subspan(1)) add(person, joint);
    }
  }
  void add(const Skeleton& person, Joint joint) {
    const auto bone = static_cast<std::size_t>(joint);
    const auto parent = static_cast<Joint>(kJointParents[bone]);
    const auto is_tracked = [&](Joint j) { return person.state(j) == TrackingState::kTracked; };
    if (!is_tracked(joint) || !is_tracked(parent)) return;
    tells[bone] = true;
    start[bone] = person[parent];
    along[bone] = person[joint] - person[parent];
  }
  /// Vector from the nearest point of a bone to a point.
  [[nodiscard]] Eigen::Vector3f off(std::size_t bone, const Eigen::Vector3f& p) const {
    const Eigen::Vector3f& b = along[bone];
    const Eigen::Vector3f from_start = p - start[bone];
    const float t = from_start.dot(b) / squared_length(b);
    return from_start - std::clamp(t, 0.0F, 1.0F) * b;
  }
};

bool is_leg_bone(std::size_t bone) {
  return is_limb_bone(Limb::kLeftLeg, bone) || is_limb_bone(Limb::kRightLeg, bone);
}

}  // namespace

void JointOffset::Sum::add(const Sum& other) {
  across += other.across;
  behind += other.behind;
  count += other.count;
}

void JointOffset::learn(const Sum& sum, Mean& mean) {
  constexpr std::int64_t kLeast = 50;  // points
  constexpr double kMemory = 60.0;     // frames
  if (sum.count < kLeast) return;
  const auto count = static_cast<double>(sum.count);
  mean.frames = std::min(mean.frames + 1.0, kMemory);
  mean.across += (sum.across / count - mean.across) / mean.frames;
  mean.behind += (sum.behind / count - mean.behind) / mean.frames;
}

void JointOffset::learn(const Skeleton& person, Limb affected, const PersonPoints& points) {
  constexpr std::int64_t kEvery = 5;  // points
  const LimbBones bones(person, affected);
  Sum arms, legs;
  for (std::int64_t i = 0; i < points.count; i += kEvery) {
    const std::size_t bone = points.label[i];
    if (!bones.tells[bone]) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const Eigen::Vector3f off = bones.off(bone, p);
    if (!(off.squaredNorm() < kFarthestFlesh * kFarthestFlesh)) continue;
    const Eigen::Vector3f ray = p.normalized();
    const float along_ray = off.dot(ray);
    Sum& sum = is_leg_bone(bone) ? legs : arms;
    sum.across += (off - along_ray * ray).cast<double>();
    sum.behind += static_cast<double>(along_ray);
    ++sum.count;
  }
  learn(arms, arms_);
  learn(legs, legs_);
  arms.add(legs);
  learn(arms, all_);
}

double JointOffset::metres() const {
  if (!(all_.frames > 0.0)) return 0.0;
  const double along = std::max({0.0, all_.behind - kMaxBehind, kMaxBefore - all_.behind});
  return std::sqrt(all_.across.squaredNorm() + along * along);
}

Eigen::Vector3d JointOffset::shared() const {
  // Points of an arm beside the trunk are assigned to the trunk, so an arm shows only a third of
  // its offset.
  constexpr double kMaxTimes = 3.0;
  const double length = all_.across.norm();
  if (!(length > 0.0)) return Eigen::Vector3d::Zero();
  const Eigen::Vector3d direction = all_.across / length;
  const double common = std::min(arms_.across.dot(direction), legs_.across.dot(direction));
  return std::clamp(kMaxTimes * common, 0.0, length) * direction;
}

double JointOffset::limit() const {
  return kMaxAcross * (1.0 + kFewFrames / std::max(1.0, all_.frames));
}

}  // namespace manip3d
