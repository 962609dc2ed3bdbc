#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>

namespace manip3d {

inline constexpr std::size_t kNumJoints = 25;

/// The joints of the Kinect V2, with its numbers. Left and right are the person's own.
enum class Joint : std::uint8_t {
  kSpineBase,
  kSpineMid,
  kNeck,
  kHead,
  kShoulderLeft,
  kElbowLeft,
  kWristLeft,
  kHandLeft,
  kShoulderRight,
  kElbowRight,
  kWristRight,
  kHandRight,
  kHipLeft,
  kKneeLeft,
  kAnkleLeft,
  kFootLeft,
  kHipRight,
  kKneeRight,
  kAnkleRight,
  kFootRight,
  kSpineShoulder,
  kHandTipLeft,
  kThumbLeft,
  kHandTipRight,
  kThumbRight
};

/// The parent of each joint; the root is its own parent. Bone j runs from the parent to joint j, so
/// bones have the number of their far ends, and there is no bone 0.
inline constexpr std::array<std::uint8_t, kNumJoints> kJointParents = {
    0, 0, 20, 2, 20, 4, 5, 6, 20, 8, 9, 10, 0, 12, 13, 14, 0, 16, 17, 18, 1, 7, 6, 11, 10};

/// The joints in an order in which each one comes after its parent.
inline constexpr std::array<std::uint8_t, kNumJoints> kJointsOutwards = {
    0, 1, 20, 2, 3, 4, 5, 6, 7, 21, 22, 8, 9, 10, 11, 23, 24, 12, 13, 14, 15, 16, 17, 18, 19};

/// The joint on the other side of the body; joints in the middle map to themselves.
inline constexpr std::array<std::uint8_t, kNumJoints> kMirroredJoints = {
    0, 1, 2, 3, 8, 9, 10, 11, 4, 5, 6, 7, 16, 17, 18, 19, 12, 13, 14, 15, 20, 23, 24, 21, 22};

inline constexpr std::array<const char*, kNumJoints> kJointNames = {
    "SpineBase",     "SpineMid",    "Neck",      "Head",          "ShoulderLeft",
    "ElbowLeft",     "WristLeft",   "HandLeft",  "ShoulderRight", "ElbowRight",
    "WristRight",    "HandRight",   "HipLeft",   "KneeLeft",      "AnkleLeft",
    "FootLeft",      "HipRight",    "KneeRight", "AnkleRight",    "FootRight",
    "SpineShoulder", "HandTipLeft", "ThumbLeft", "HandTipRight",  "ThumbRight"};

enum class TrackingState : std::uint8_t { kNotTracked, kInferred, kTracked };

inline constexpr std::uint8_t kNoBody = 0xff;  ///< Body index of pixels that belong to nobody.

/// One person's pose in the frame of the camera that sees it: metres, x right, y down, z ahead.
struct Skeleton {
  std::array<Eigen::Vector3f, kNumJoints> positions = all_at_origin();
  /// Unit quaternions w, x, y, z: from the bone that ends at the joint to the camera frame; 0 if
  /// there is none.
  std::array<std::array<float, 4>, kNumJoints> orientations{};
  std::array<TrackingState, kNumJoints> states{};
  std::int64_t id = 0;          ///< Constant while the sensor tracks the person.
  std::uint8_t body = kNoBody;  ///< Value of the person's pixels in the body index image.

  [[nodiscard]] const Eigen::Vector3f& operator[](Joint joint) const {
    return positions[static_cast<std::size_t>(joint)];
  }
  [[nodiscard]] TrackingState state(Joint joint) const {
    return states[static_cast<std::size_t>(joint)];
  }

 private:
  /// Sets all positions, because Eigen leaves `{}` uninitialized.
  static std::array<Eigen::Vector3f, kNumJoints> all_at_origin() {
    std::array<Eigen::Vector3f, kNumJoints> positions;
    positions.fill(Eigen::Vector3f::Zero());
    return positions;
  }
};

}  // namespace manip3d
