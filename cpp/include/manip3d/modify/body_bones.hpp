#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"

/// @file
/// The bones among which a person's points are shared out.
namespace manip3d {

/// Which bone is the nearest one to a point.
enum class BoneRule : std::uint8_t {
  kSkin,  ///< The one whose skin is (segment_bones): a trunk is thicker than an arm.
  kPaper  ///< The one itself, dissertation eq. 4.1: a trunk is no thicker than an arm.
};

/// Radii of the flesh around a bone at both of its ends, metres.
struct BoneRadii {
  float start = 0.0F, end = 0.0F;
};

/// Straight pieces of bone, each with a label and its radii, in between which it tapers. Several
/// may have the same label.
struct BoneSegments {
  static constexpr std::size_t kCapacity = 32;
  std::size_t count = 0;
  std::array<Eigen::Vector3f, kCapacity> start, end;
  std::array<BoneRadii, kCapacity> radii{};
  std::array<std::uint8_t, kCapacity> label{};
  void add(const Eigen::Vector3f& from, const Eigen::Vector3f& to, std::size_t number,
           const BoneRadii& thickness);
};

/// The bones whose two joints are usable, in order of their numbers.
///
/// With BoneRule::kSkin they have radii: girths, breadths and depths of the mean adult [Gordon et
/// al., "2012 Anthropometric Survey of U.S. Army Personnel", Natick/TR-15/007], scaled by the
/// lengths of the person's own arms and legs against those of the mean adult (the median of eight
/// ratios; without any usable one, bones have no radii). A trunk is broader than deep: each of its
/// two bones is a pair of rods side by side, from the hips to the waist and on to the chest. With
/// BoneRule::kPaper all radii are 0.
///
/// `trunk` scales breadth and depth of the trunk; it is above 1 for a stout person.
BoneSegments body_bones(const Skeleton& skeleton, BoneRule rule, float trunk = 1.0F);

/// body_bones() with all of a limb as one bone of number limb_label(): the line through its
/// tracked joints, straight where inner ones are not tracked. With kSkin it grows, from its root
/// to the next of these joints, by a standard deviation of a thigh's girth: rather is a sliver of
/// the trunk taken for the limb than one of the limb for the trunk.
///
/// Where none beyond the root is tracked, the limb is looked for where the other one is, mirrored,
/// from the root on: kPaper along the straight line to its end, kSkin along its joints, and, for a
/// stump that does not move with the other limb, as a first bone that hangs along the spine and one
/// half way between.
BoneSegments body_bones(const Skeleton& skeleton, BoneRule rule, Limb collapsed,
                        const Mirror& mirror, float trunk = 1.0F);

}  // namespace manip3d
