#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {

/// Squared length of a bone, square metres, as a divisor: above 0 also for a bone whose joints
/// coincide.
template <typename Vector>
typename Vector::Scalar squared_length(const Vector& bone) {
  constexpr auto kPoint = static_cast<typename Vector::Scalar>(1e-9);
  return std::max(bone.squaredNorm(), kPoint);
}

/// Unit vector from the parent joint of a bone to its own joint; no value if one of them is not
/// usable or the bone has no length.
inline std::optional<Eigen::Vector3d> bone_direction(const Skeleton& skeleton, std::size_t bone) {
  const std::size_t parent = kJointParents[bone];
  if (!is_usable(skeleton, static_cast<Joint>(parent)) ||
      !is_usable(skeleton, static_cast<Joint>(bone))) {
    return {};
  }
  const Eigen::Vector3d along =
      (skeleton.positions[bone] - skeleton.positions[parent]).cast<double>();
  constexpr double kShort = 1e-6;  // metres
  if (!(along.norm() > kShort)) return {};
  return along.normalized();
}

}  // namespace manip3d
