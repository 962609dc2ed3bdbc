#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/skeleton.hpp"

/// @file
/// A simple person for tests that do not depend on the exact shape: disks along the bones.
namespace manip3d::testing {

inline Intrinsics small_kinect() {
  return {256, 212, 182.5, 182.5, 127.5, 105.5, {}, nullptr, false};
}

/// A person who stands in front of the camera, shifted to the side by x metres.
inline Skeleton standing_person(float x) {
  constexpr float kPlaces[kNumJoints][2] = {
      {0, 0},        {0, -.30F},    {0, -.56F},    {0, -.72F},     {.19F, -.46F},
      {.32F, -.22F}, {.40F, .01F},  {.42F, .08F},  {-.19F, -.46F}, {-.32F, -.22F},
      {-.40F, .01F}, {-.42F, .08F}, {.10F, .06F},  {.13F, .48F},   {.14F, .88F},
      {.15F, .93F},  {-.10F, .06F}, {-.13F, .48F}, {-.14F, .88F},  {-.15F, .93F},
      {0, -.50F},    {.44F, .16F},  {.38F, .07F},  {-.44F, .16F},  {-.38F, .07F}};
  Skeleton skeleton;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    skeleton.positions[joint] = {x + kPlaces[joint][0], kPlaces[joint][1], 2.44F};
  }
  skeleton.states.fill(TrackingState::kTracked);
  skeleton.body = 0;
  return skeleton;
}

inline void draw_disks(const Skeleton& skeleton, const Intrinsics& camera,
                       std::vector<std::uint16_t>& depth, std::vector<std::uint8_t>& body_index) {
  depth.assign(camera.width * camera.height, 0);
  body_index.assign(depth.size(), 0xff);
  constexpr int kDisks = 12, kRadius = 5;
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    const Eigen::Vector3f from = skeleton.positions[kJointParents[bone]];
    for (int i = 0; i <= kDisks; ++i) {
      const Eigen::Vector3f p =
          from + static_cast<float>(i) / kDisks * (skeleton.positions[bone] - from);
      const Eigen::Vector2d centre = project(camera, p.cast<double>());
      for (int y = -kRadius; y <= kRadius; ++y) {
        for (int x = -kRadius; x <= kRadius; ++x) {
          const auto u = static_cast<std::int64_t>(std::lround(centre.x())) + x;
          const auto v = static_cast<std::int64_t>(std::lround(centre.y())) + y;
          if (x * x + y * y > kRadius * kRadius || u < 0 || v < 0 || u >= camera.width ||
              v >= camera.height) {
            continue;
          }
          const auto pixel = static_cast<std::size_t>(v * camera.width + u);
          depth[pixel] = static_cast<std::uint16_t>(1000.0F * p.z() - 40.0F + x * x + y * y);
          body_index[pixel] = skeleton.body;
        }
      }
    }
  }
}

}  // namespace manip3d::testing
