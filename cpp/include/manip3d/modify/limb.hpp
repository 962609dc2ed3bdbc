#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

/// The person's own left and right.
enum class Limb : std::uint8_t { kLeftArm, kRightArm, kLeftLeg, kRightLeg };
inline constexpr std::size_t kNumLimbs = 4;

constexpr bool is_arm(Limb limb) { return limb == Limb::kLeftArm || limb == Limb::kRightArm; }
constexpr Limb opposite(Limb limb) {
  return static_cast<Limb>(static_cast<std::uint8_t>(limb) ^ 1U);
}

/// The joints from the root (shoulder, hip) outwards: the first four, and a hand's tip. The thumb
/// is a branch of its own.
std::span<const Joint> limb_chain(Limb limb);
inline constexpr std::size_t kNumMainJoints = 4;  ///< Root, elbow or knee, wrist or ankle, end.

constexpr Joint limb_root(Limb limb) {
  constexpr Joint kRoots[kNumLimbs] = {Joint::kShoulderLeft, Joint::kShoulderRight, Joint::kHipLeft,
                                       Joint::kHipRight};
  return kRoots[static_cast<std::size_t>(limb)];
}
/// The number that stands for all of the limb where it is one bone: that of its first bone.
constexpr std::uint8_t limb_label(Limb limb) {
  return static_cast<std::uint8_t>(static_cast<std::uint8_t>(limb_root(limb)) + 1);
}
/// Does a bone belong to the limb, beyond its root?
bool is_limb_bone(Limb limb, std::size_t bone);

}  // namespace manip3d
