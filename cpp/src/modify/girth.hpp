#pragma once

#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// Stoutness of a person, estimated over the frames.
///
/// The points of a trunk or a limb lie on the skin of its bones if the bones have the right radii.
/// The median distance of the points outside the skin is added to the girth, minus an allowance for
/// clothes and for joints whose depth is wrong. Nobody is estimated to be thinner than the mean
/// adult.
class Girth {
 public:
  /// The scale of the trunk that body_bones takes.
  [[nodiscard]] float trunk() const { return trunk_; }
  /// Distance of the skin of the trunk from that of the mean adult, metres, outwards.
  [[nodiscard]] float around_trunk() const { return (trunk_ - 1.0F) * kWaist; }
  /// Distance of the skin of a limb from that of its bones, metres, outwards.
  [[nodiscard]] float limb() const { return limb_; }

  /// Updates the girth with a frame that was segmented with bones of this girth: completely from
  /// the first one, slowly from later ones. Returns the change of the scale of the trunk.
  float learn(const BoneSegments& bones, const PersonPoints& points, Limb limb);

  /// Whether this is still the first frame.
  [[nodiscard]] bool is_new() const { return is_new_; }
  void settle() { is_new_ = false; }

  void reset() { *this = {}; }

 private:
  static constexpr float kWaist = 0.12F;  ///< Radius of the mean adult's waist, metres.
  float trunk_ = 1.0F, limb_ = 0.0F;
  bool is_new_ = true;
};

}  // namespace manip3d
