#include "modify/joint_offset.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

// Metres. Chosen on the tuning half of benchmarks/bench_people.py, where the mean over the limbs of
// a trial comes up to 3.2 cm beside their bones while it runs, and 3 to 7 cm before them.
constexpr double kMostAcross = 0.045;
constexpr double kMostBehind = 0.03;   // trackers that lift joints from the skin tell 0
constexpr double kMostBefore = -0.16;  // of stout people in thick clothes
constexpr double kFewFrames = 1.0;
constexpr float kFarthestFlesh = 0.35F;  // points farther from a bone are not its flesh

/// The bones of a person's limbs, but for the affected one.
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
  /// From the nearest place of a bone to a point.
  [[nodiscard]] Eigen::Vector3f off(std::size_t bone, const Eigen::Vector3f& p) const {
    const Eigen::Vector3f& b = along[bone];
    const Eigen::Vector3f from_start = p - start[bone];
    const float t = from_start.dot(b) / std::max(b.squaredNorm(), 1e-9F);
    return from_start - std::clamp(t, 0.0F, 1.0F) * b;
  }
};

}  // namespace

void JointOffset::learn(const Skeleton& person, Limb affected, const PersonPoints& points) {
  constexpr std::int64_t kEvery = 5, kLeast = 50;  // points
  constexpr double kMemory = 60.0;                 // frames
  const LimbBones bones(person, affected);
  Eigen::Vector3d across = Eigen::Vector3d::Zero();
  double behind = 0.0;
  std::int64_t count = 0;
  for (std::int64_t i = 0; i < points.count; i += kEvery) {
    const std::size_t bone = points.label[i];
    if (!bones.tells[bone]) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const Eigen::Vector3f off = bones.off(bone, p);
    if (!(off.squaredNorm() < kFarthestFlesh * kFarthestFlesh)) continue;
    const Eigen::Vector3f ray = p.normalized();
    const float along_ray = off.dot(ray);
    across += (off - along_ray * ray).cast<double>();
    behind += static_cast<double>(along_ray);
    ++count;
  }
  if (count < kLeast) return;
  frames_ = std::min(frames_ + 1.0, kMemory);
  across_ += (across / static_cast<double>(count) - across_) / frames_;
  behind_ += (behind / static_cast<double>(count) - behind_) / frames_;
}

double JointOffset::metres() const {
  if (!(frames_ > 0.0)) return 0.0;
  const double along = std::max({0.0, behind_ - kMostBehind, kMostBefore - behind_});
  return std::sqrt(across_.squaredNorm() + along * along);
}

double JointOffset::limit() const {
  return kMostAcross * (1.0 + kFewFrames / std::max(1.0, frames_));
}

}  // namespace manip3d
