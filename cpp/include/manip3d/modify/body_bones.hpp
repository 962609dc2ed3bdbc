#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"

/// @file
/// The bones into which a person's points are segmented.
namespace manip3d {

/// Distance that decides which bone is nearest to a point.
enum class BoneRule : std::uint8_t {
  kSkin,  ///< Distance to the bone's skin (segment_bones): a trunk is thicker than an arm.
  kPaper  ///< Distance to the line of the bone, dissertation eq. 4.1.
};

/// Whether a bone belongs to the spine below the neck.
inline bool is_spine_bone(std::uint8_t bone) {
  return bone == static_cast<std::uint8_t>(Joint::kSpineMid) ||
         bone == static_cast<std::uint8_t>(Joint::kSpineShoulder);
}

/// Radii of the body around a bone at its two ends, metres.
struct BoneRadii {
  float start = 0.0F, end = 0.0F;
};

/// Straight bone segments, each with a label and a radius at each end; the radius is linear in
/// between. Several segments may have the same label.
struct BoneSegments {
  static constexpr std::size_t kCapacity = 32;
  std::size_t count = 0;
  std::array<Eigen::Vector3f, kCapacity> start, end;
  std::array<BoneRadii, kCapacity> radii{};
  std::array<std::uint8_t, kCapacity> label{};
  void add(const Eigen::Vector3f& from, const Eigen::Vector3f& to, std::size_t number,
           const BoneRadii& thickness);
};

/// Bones whose two joints are usable, in the order of their numbers.
///
/// With BoneRule::kSkin they have radii: girths, breadths and depths of the mean adult [Gordon et
/// al., "2012 Anthropometric Survey of U.S. Army Personnel", Natick/TR-15/007], scaled by the ratio
/// of the lengths of the person's arms and legs to those of the mean adult (the median of eight
/// ratios; without any usable length, all radii are 0). A trunk is broader than deep: each of its
/// two bones is represented by two parallel segments, from the hips to the waist and from there to
/// the chest. With BoneRule::kPaper all radii are 0.
///
/// @param trunk  Factor on the breadth and depth of the trunk; above 1 for a stout person.
BoneSegments body_bones(const Skeleton& skeleton, BoneRule rule, float trunk = 1.0F);

/// Bones as above, with the limb `collapsed` as one bone of the label limb_label(): the line
/// through its tracked joints, which is straight across inner joints that are not tracked. With
/// kSkin the radius of its first segment, from its root to the next tracked joint, is increased by
/// a standard deviation of a thigh's girth, because labelling a strip of the trunk as limb does
/// less harm than labelling a strip of the limb as trunk.
///
/// If no joint beyond the root is tracked, the limb is assumed at the mirror image of the opposite
/// limb, shifted to its own root: with kPaper along the straight line to its end, with kSkin along
/// its joints. With kSkin two more first bones are added for a stump that does not move with the
/// other limb: one that hangs parallel to the spine, and one half way between that and the mirrored
/// first bone.
BoneSegments body_bones(const Skeleton& skeleton, BoneRule rule, Limb collapsed,
                        const Mirror& mirror, float trunk = 1.0F);

}  // namespace manip3d
