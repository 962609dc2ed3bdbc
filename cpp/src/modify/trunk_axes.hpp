#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/limb.hpp"
#include "manip3d/modify/mirror.hpp"

/// @file
/// The axes of a body from the joints of its trunk.
namespace manip3d {

/// Trust in each joint: 1 for an exact one, 0 for one that was never seen.
using JointTrust = std::array<double, kNumJoints>;

inline double trust_of(const JointTrust& trust, Joint joint) {
  return trust[static_cast<std::size_t>(joint)];
}

inline constexpr std::array kSpineJoints = {Joint::kSpineBase, Joint::kSpineMid,
                                            Joint::kSpineShoulder, Joint::kNeck};
/// Share of the spine's sideways tilt that a plane for legs keeps.
inline constexpr double kLeftTilt = 0.2;
/// Metres between the shoulders and between the hips of an adult.
inline constexpr double kAdultShoulders = 0.35, kAdultHips = 0.18;
/// The weight of the pair of joints to which the limb is not attached. Shoulders are twice as far
/// apart as hips; with this factor, both pairs have the same influence on a plane for legs.
inline constexpr double kOtherPair = 0.5;

/// Compute the axes of a body from all usable joints of its trunk. y is the line through the joints
/// of the spine; x is the mean of the directions from right to left, in which shoulders have the
/// larger weight for arms, hips for legs; n is x made orthogonal to y, for legs with most of its
/// sideways tilt relative to the vertical removed. The origin is at the height of SpineMid for
/// arms, of SpineBase for legs. A missing shoulder or hip is replaced by the middle of the spine at
/// its height. Each joint is weighted by its trust.
///
/// No value with fewer than two joints of the spine or without a pair, or for axes that
/// body_frame() rejects.
/// @param down  Vertical as a unit vector, because a camera may be tilted.
std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb, const JointTrust& trust,
                                     const Eigen::Vector3d& down);

/// Overload with equal trust in all joints.
std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb,
                                     const Eigen::Vector3d& down);

}  // namespace manip3d
