#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

#include "manip3d/geometry/skeleton.hpp"

/// @file
/// The pose of a trunk, and its twist.
namespace manip3d {

/// Transform from the trunk to the camera frame.
struct TrunkPose {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  [[nodiscard]] Eigen::Vector3d operator()(const Eigen::Vector3d& p) const {
    return rotation * p + translation;
  }
};

inline constexpr std::array kTrunkJoints = {
    Joint::kSpineBase,    Joint::kSpineMid,      Joint::kSpineShoulder, Joint::kNeck,
    Joint::kShoulderLeft, Joint::kShoulderRight, Joint::kHipLeft,       Joint::kHipRight};

inline bool is_on_pelvis(Joint joint) {
  return joint == Joint::kSpineBase || joint == Joint::kHipLeft || joint == Joint::kHipRight;
}

/// The rotation by a small rotation vector, exact to third order without transcendental functions.
inline Eigen::Quaterniond small_turn(const Eigen::Vector3d& w) {
  return Eigen::Quaterniond(1.0, 0.5 * w.x(), 0.5 * w.y(), 0.5 * w.z()).normalized();
}

/// Turns a vector of the trunk about the spine, its y axis. As in small_turn(), half the angle is
/// used for the tangent of half the angle.
inline Eigen::Vector3d about_spine(const Eigen::Vector3d& p, double angle) {
  const double half = 0.5 * angle, scale = 1.0 / (1.0 + half * half);
  const double c = (1.0 - half * half) * scale, s = 2.0 * half * scale;
  return {c * p.x() + s * p.z(), p.y(), c * p.z() - s * p.x()};
}

/// Turns a joint of the pelvis by about_spine(); joints of the chest do not move.
inline Eigen::Vector3d with_pelvis(const Eigen::Vector3d& p, Joint joint, double angle) {
  return is_on_pelvis(joint) ? about_spine(p, angle) : p;
}

}  // namespace manip3d
