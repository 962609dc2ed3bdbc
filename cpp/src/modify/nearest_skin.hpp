#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "manip3d/modify/body_bones.hpp"
#include "modify/bone_direction.hpp"

namespace manip3d {

struct NearestSkin {
  float distance = std::numeric_limits<float>::max();  ///< Metres; below 0 inside of the capsule.
  std::uint8_t label = 0;                              ///< Bone of the skin; 0: there is none.
  Eigen::Vector3f on_bone = Eigen::Vector3f::Zero();   ///< Nearest point of the bone.
  float radius = 0.0F;                                 ///< Radius of the bone there.
};

/// The skin nearest to p among the bones for whose label counts(label) holds.
template <typename Counts>
NearestSkin nearest_skin(const Eigen::Vector3f& p, const BoneSegments& bones,
                         const Counts& counts) {
  NearestSkin nearest;
  for (std::size_t k = 0; k < bones.count; ++k) {
    if (!counts(bones.label[k])) continue;
    const Eigen::Vector3f bone = bones.end[k] - bones.start[k], from = p - bones.start[k];
    const float t = std::clamp(from.dot(bone) / squared_length(bone), 0.0F, 1.0F);
    const BoneRadii& r = bones.radii[k];
    const float radius = r.start + t * (r.end - r.start), skin = (from - t * bone).norm() - radius;
    if (skin < nearest.distance) {
      nearest = {skin, bones.label[k], bones.start[k] + t * bone, radius};
    }
  }
  return nearest;
}

}  // namespace manip3d
