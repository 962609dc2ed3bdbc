#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "manip3d/modify/body_bones.hpp"

namespace manip3d {

/// Standard deviation of girths as a share of their mean; 0.09 to 0.12 in the survey of
/// BoneRule::kSkin.
inline constexpr float kGirths = 0.1F;
inline constexpr float kJointJitter = 0.01F;  // metres: jitter of a Kinect V2's joints
/// Standard deviations above which a distance is no longer chance.
inline constexpr float kOutlier = 3.0F;

/// Standard deviation of the distance of the skin from its expected place, metres.
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
  // The first of each pair is the value at P_c, the second the difference from there to P_r.
  Column radius{}, taper{};
  /// kJointJitter / spread: 1 if only joints vary, less for thick bones.
  Column certainty{}, firmer{};
  Column outer{}, widens{};  ///< The radius, enlarged for outliers (see judged()).
  Column slope{};            ///< Largest change of the distance to the skin by a step of length 1.
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

  /// Squared distance to the line of the bone; `along` is the position of the nearest point: 0 at
  /// P_c, 1 at P_r.
  [[nodiscard]] float squared_distance(std::size_t i, float x, float y, float z,
                                       float& along) const {
    const float dx = x - cx[i], dy = y - cy[i], dz = z - cz[i];
    float t = dx * tx[i] + dy * ty[i] + dz * tz[i];
    t = t > 0.0F ? t : 0.0F;
    // Measured from P_r itself, so that bones that meet there have the same distance.
    const bool past = t >= 1.0F;
    const float ex = past ? x - rx[i] : dx - t * bx[i];
    const float ey = past ? y - ry[i] : dy - t * by[i];
    const float ez = past ? z - rz[i] : dz - t * bz[i];
    along = past ? 1.0F : t;
    return ex * ex + ey * ey + ez * ez;
  }

  /// Measure of how near a skin is, from the distance to the bone: the distance to the skin in
  /// standard deviations, times kJointJitter. Beyond kOutlier standard deviations it grows like
  /// metres, so that the nearest of several distant bones wins.
  [[nodiscard]] float judged(std::size_t i, float distance, float along) const {
    const float skin = distance - (radius[i] + along * taper[i]);
    const float far = distance - (outer[i] + along * widens[i]);
    return std::max(skin * (certainty[i] + along * firmer[i]), far);
  }
};

}  // namespace manip3d
