#pragma once

#include "manip3d/modify/body_bones.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/segmentation.hpp"

namespace manip3d {

/// How stout a person is, over the frames.
///
/// The points of a trunk or a limb lie on the skin of its bones if these are as thick as it. What
/// they lie farther out, in the median, is girth, but for an allowance for clothes and for joints
/// that are off in depth. Nobody is taken to be thinner than the mean adult.
class Girth {
 public:
  /// The scale of the trunk that body_bones takes.
  [[nodiscard]] float trunk() const { return trunk_; }
  /// By how much the skin of the trunk lies farther out than the mean adult's, metres.
  [[nodiscard]] float around_trunk() const { return (trunk_ - 1.0F) * kWaist; }
  /// By how much the skin of a limb lies farther out than that of its bones, metres.
  [[nodiscard]] float limb() const { return limb_; }

  /// Learns from a frame that was segmented with bones of this girth: at once from the first one,
  /// slowly from those after it. Returns by how much the scale of the trunk changed.
  float learn(const BoneSegments& bones, const PersonPoints& points, Limb limb);

  /// Is this still the first frame?
  [[nodiscard]] bool is_new() const { return is_new_; }
  void settle() { is_new_ = false; }

  void reset() { *this = {}; }

 private:
  static constexpr float kWaist = 0.12F;  ///< Radius of the mean adult's, metres.
  float trunk_ = 1.0F, limb_ = 0.0F;
  bool is_new_ = true;
};

}  // namespace manip3d
