#include "manip3d/modify/limb.hpp"

#include <array>

namespace manip3d {

std::span<const Joint> limb_chain(Limb limb) {
  using enum Joint;
  static constexpr std::array kLeftArm = {kShoulderLeft, kElbowLeft, kWristLeft, kHandLeft,
                                          kHandTipLeft};
  static constexpr std::array kRightArm = {kShoulderRight, kElbowRight, kWristRight, kHandRight,
                                           kHandTipRight};
  static constexpr std::array kLeftLeg = {kHipLeft, kKneeLeft, kAnkleLeft, kFootLeft};
  static constexpr std::array kRightLeg = {kHipRight, kKneeRight, kAnkleRight, kFootRight};
  switch (limb) {
    case Limb::kLeftArm:
      return kLeftArm;
    case Limb::kRightArm:
      return kRightArm;
    case Limb::kLeftLeg:
      return kLeftLeg;
    default:
      return kRightLeg;
  }
}

bool is_limb_bone(Limb limb, std::size_t bone) {
  while (bone != kJointParents[bone]) {
    bone = kJointParents[bone];
    if (bone == static_cast<std::size_t>(limb_root(limb))) return true;
  }
  return false;
}

}  // namespace manip3d
