#include "modify/girth.hpp"

#include <algorithm>
#include <array>
#include <optional>
#include <span>

#include "geometry/median.hpp"

namespace manip3d {
namespace {

// Allowances for clothes: kClothedTrunk as a share of the waist's radius, kClothedLimb in metres.
// They were chosen on the tuning half of benchmarks/bench_people.py, on which medians are -0.15 to
// 0.29 of the radius of the waist and 0.01 to 0.04 m for limbs. kStoutest and kThickest (metres)
// are the upper limits of the result.
constexpr float kClothedTrunk = 0.3F, kClothedLimb = 0.03F;
constexpr float kStoutest = 1.8F, kThickest = 0.08F;

/// The median distance of the points of some bones from their skin, metres; no value if there are
/// too few points.
template <typename IsPart>
std::optional<float> median_outside(const PersonPoints& points, const IsPart& is_part) {
  constexpr std::int64_t kMaxSamples = 1024;
  constexpr std::size_t kMinOutside = 50;
  std::array<float, kMaxSamples> outside;
  std::size_t count = 0;
  const std::int64_t stride = points.count / kMaxSamples + 1;
  for (std::int64_t i = 0; i < points.count; i += stride) {
    if (is_part(points.label[i])) outside[count++] = points.skin_distance[i];
  }
  if (count < kMinOutside) return std::nullopt;
  return median(std::span(outside.data(), count));
}

/// The radius of the waist, metres; 0 if the trunk has none.
float waist_radius(const BoneSegments& bones) {
  for (std::size_t k = 0; k < bones.count; ++k) {
    if (bones.label[k] == static_cast<std::uint8_t>(Joint::kSpineShoulder)) {
      return bones.radii[k].start;
    }
  }
  return 0.0F;
}

}  // namespace

float Girth::learn(const BoneSegments& bones, const PersonPoints& points, Limb limb) {
  const float rate = is_new_ ? 1.0F : 0.2F;  // weight of this frame
  const auto limb_skin =
      median_outside(points, [&](std::uint8_t bone) { return is_limb_bone(limb, bone); });
  if (limb_skin) {
    limb_ += rate * (std::clamp(*limb_skin - kClothedLimb, 0.0F, kThickest) - limb_);
  }
  const float waist = waist_radius(bones);
  const auto trunk_skin = median_outside(points, is_spine_bone);
  if (!(waist > 0.0F) || !trunk_skin) return 0.0F;
  const float excess = trunk_ * *trunk_skin / waist;  // as a share of the mean adult's waist
  const float wanted = std::clamp(trunk_ + excess - kClothedTrunk, 1.0F, kStoutest);
  const float change = rate * (wanted - trunk_);
  trunk_ += change;
  return change;
}

}  // namespace manip3d
