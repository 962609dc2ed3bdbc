#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "manip3d/modify/body_bones.hpp"

namespace manip3d {

inline constexpr float kGirths =
    0.1F;  // of their mean: 0.09 to 0.12 in the survey of BoneRule::kSkin
inline constexpr float kJointJitter = 0.01F;  // metres: jitter of a Kinect V2's joints
inline constexpr float kOutlier = 3.0F;       // standard deviations that are not chance any more

/// By how much the skin at a place of a bone is likely to be off, metres: standard deviation.
inline float spread(float radius) {
  const float girth = kGirths * radius;
  return std::sqrt(girth * girth + kJointJitter * kJointJitter);
}

/// Bones as arrays of coordinates, for loops over bones and over points.
struct BoneTable {
  using Column = std::array<float, BoneSegments::kCapacity>;
  Column cx{}, cy{}, cz{};  ///< P_c.
  Column rx{}, ry{}, rz{};  ///< P_r.
  Column bx{}, by{}, bz{};  ///< P_r - P_c.
  Column tx{}, ty{}, tz{};  ///< (P_r - P_c) / |P_r - P_c|^2, or 0.
  // The first of each pair is at P_c, the second is what is added up to P_r.
  Column radius{}, taper{};
  Column certainty{}, firmer{};  ///< 1 where joints alone are off; less the more flesh there is.
  Column outer{}, widens{};      ///< The radius and what it gains among outliers.
  Column slope{};  ///< Largest change of the distance to the skin by a step of length 1.
  std::array<std::int32_t, BoneSegments::kCapacity> label{};
  std::size_t count = 0;
  bool has_radii = false;

  explicit BoneTable(const BoneSegments& bones) : count(bones.count) {
    for (std::size_t i = 0; i < count; ++i) {
      const Eigen::Vector3f b = bones.end[i] - bones.start[i];
      constexpr float kPoint = 1e-12F;  // squared metres
      const float length2 = b.squaredNorm();
      const bool is_point = !(length2 > kPoint);
      const Eigen::Vector3f t =
          is_point ? Eigen::Vector3f(Eigen::Vector3f::Zero()) : Eigen::Vector3f(b / length2);
      cx[i] = bones.start[i].x(), cy[i] = bones.start[i].y(), cz[i] = bones.start[i].z();
      rx[i] = bones.end[i].x(), ry[i] = bones.end[i].y(), rz[i] = bones.end[i].z();
      bx[i] = b.x(), by[i] = b.y(), bz[i] = b.z();
      tx[i] = t.x(), ty[i] = t.y(), tz[i] = t.z();
      label[i] = bones.label[i];
      const float length = is_point ? 0.0F : std::sqrt(length2);
      radius[i] = bones.radii[i].start;
      taper[i] = std::clamp(bones.radii[i].end - radius[i], -length, length);
      slope[i] = is_point ? 1.0F : 1.0F + std::abs(taper[i]) / length;
      const float from = spread(radius[i]), to = spread(radius[i] + taper[i]);
      certainty[i] = kJointJitter / from;
      firmer[i] = kJointJitter / to - certainty[i];
      outer[i] = radius[i] + kOutlier * (from - kJointJitter);
      widens[i] = taper[i] + kOutlier * (to - from);
      has_radii = has_radii || bones.radii[i].start != 0.0F || bones.radii[i].end != 0.0F;
    }
  }

  /// Squared, from the bone itself; `along` is where its nearest point is: 0 at P_c, 1 at P_r.
  [[nodiscard]] float squared_distance(std::size_t i, float x, float y, float z,
                                       float& along) const {
    const float dx = x - cx[i], dy = y - cy[i], dz = z - cz[i];
    float t = dx * tx[i] + dy * ty[i] + dz * tz[i];
    t = t > 0.0F ? t : 0.0F;
    const bool past = t >= 1.0F;  // from P_r itself, so that bones that meet there are as near
    const float ex = past ? x - rx[i] : dx - t * bx[i];
    const float ey = past ? y - ry[i] : dy - t * by[i];
    const float ez = past ? z - rz[i] : dz - t * bz[i];
    along = past ? 1.0F : t;
    return ex * ex + ey * ey + ez * ez;
  }

  /// What the nearness of a skin is judged by, from the distance to the bone: the distance to the
  /// skin in standard deviations times kJointJitter; from kOutlier of them on it grows as metres
  /// do, so that of bones that are all far off the nearest one wins.
  [[nodiscard]] float judged(std::size_t i, float distance, float along) const {
    const float skin = distance - (radius[i] + along * taper[i]);
    const float far = distance - (outer[i] + along * widens[i]);
    return std::max(skin * (certainty[i] + along * firmer[i]), far);
  }
};

}  // namespace manip3d
