#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <initializer_list>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {

inline bool are_usable(const Skeleton& skeleton, std::initializer_list<Joint> joints) {
  return std::all_of(joints.begin(), joints.end(),
                     [&](Joint joint) { return is_usable(skeleton, joint); });
}

/// Columns: to the person's left, up the spine, and ahead. No value if joints are missing or
/// coincide.
inline std::optional<Eigen::Matrix3f> torso_frame(const Skeleton& skeleton) {
  using enum Joint;
  if (!are_usable(skeleton, {kSpineBase, kSpineShoulder, kShoulderLeft, kShoulderRight})) return {};
  const Eigen::Vector3f spine = skeleton[kSpineShoulder] - skeleton[kSpineBase];
  const Eigen::Vector3f up = spine.normalized();
  const Eigen::Vector3f shoulders = skeleton[kShoulderLeft] - skeleton[kShoulderRight];
  const Eigen::Vector3f across = shoulders - shoulders.dot(up) * up;
  constexpr float kFlat = 1e-3F;  // metres; shorter vectors define no axis
  if (!(spine.norm() > kFlat && across.norm() > kFlat)) return {};
  const Eigen::Vector3f left = across.normalized();
  Eigen::Matrix3f axes;
  axes << left, up, left.cross(up);
  return axes;
}

}  // namespace manip3d
