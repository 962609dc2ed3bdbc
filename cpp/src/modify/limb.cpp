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

}  // namespace manip3d
