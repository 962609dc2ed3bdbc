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

/// How far each joint is trusted: 1 is an exact one, 0 one that was never seen.
using JointTrust = std::array<double, kNumJoints>;

inline double trust_of(const JointTrust& trust, Joint joint) {
  return trust[static_cast<std::size_t>(joint)];
}

inline constexpr std::array kSpineJoints = {Joint::kSpineBase, Joint::kSpineMid,
                                            Joint::kSpineShoulder, Joint::kNeck};
/// Share of a plane for legs that the spine's sideways tilt keeps.
inline constexpr double kLeftTilt = 0.2;
/// Metres between the shoulders and between the hips of an adult.
inline constexpr double kAdultShoulders = 0.35, kAdultHips = 0.18;
/// The weight of the pair that does not bear the limb. Shoulders are twice as far apart as hips, so
/// halved they count as much: for legs.
inline constexpr double kOtherPair = 0.5;

/// The axes of a body from all usable joints of its trunk: y along the line through the middle
/// ones, x the mean of the directions from right to left (shoulders count most for arms, hips for
/// legs), n = x made square to y, for legs with most of its sideways tilt against the vertical
/// taken out. The origin is at the height of SpineMid for arms, of SpineBase for legs. A
/// shoulder or hip that is missing is replaced by the middle of the spine there. Each joint counts
/// by its trust.
///
/// None with fewer than two joints in the middle or no pair, or axes as in body_frame().
/// @param down  unit vector: a camera may be tilted.
std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb, const JointTrust& trust,
                                     const Eigen::Vector3d& down);

/// The same, where all joints are trusted alike.
std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb,
                                     const Eigen::Vector3d& down);

}  // namespace manip3d
