#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

/// Left and right are the person's own.
enum class Limb : std::uint8_t { kLeftArm, kRightArm, kLeftLeg, kRightLeg };
inline constexpr std::size_t kNumLimbs = 4;

constexpr bool is_arm(Limb limb) { return limb == Limb::kLeftArm || limb == Limb::kRightArm; }
constexpr Limb opposite(Limb limb) {
  return static_cast<Limb>(static_cast<std::uint8_t>(limb) ^ 1U);
}

/// The joints from the root (shoulder or hip) outwards: the four main ones, and the tip of a hand.
/// The thumb branches off and is not included.
std::span<const Joint> limb_chain(Limb limb);
inline constexpr std::size_t kNumMainJoints = 4;  ///< Root, elbow or knee, wrist or ankle, end.

constexpr Joint limb_root(Limb limb) {
  constexpr Joint kRoots[kNumLimbs] = {Joint::kShoulderLeft, Joint::kShoulderRight, Joint::kHipLeft,
                                       Joint::kHipRight};
  return kRoots[static_cast<std::size_t>(limb)];
}
/// Label of a limb that is treated as one bone: that of its first bone.
constexpr std::uint8_t limb_label(Limb limb) {
  return static_cast<std::uint8_t>(static_cast<std::uint8_t>(limb_root(limb)) + 1);
}

/// The bones of each limb, beyond its root. A table, because pixels are tested against it.
inline constexpr auto kLimbBones = [] {
  std::array<std::array<bool, kNumJoints>, kNumLimbs> bones{};
  for (std::size_t limb = 0; limb < kNumLimbs; ++limb) {
    const auto root = static_cast<std::size_t>(limb_root(static_cast<Limb>(limb)));
    for (const std::size_t bone : kJointsOutwards) {
      const std::size_t parent = kJointParents[bone];
      bones[limb][bone] = parent == root || bones[limb][parent];
    }
  }
  return bones;
}();
/// Whether a bone belongs to the limb, beyond its root.
constexpr bool is_limb_bone(Limb limb, std::size_t bone) {
  return kLimbBones[static_cast<std::size_t>(limb)][bone];
}

}  // namespace manip3d
