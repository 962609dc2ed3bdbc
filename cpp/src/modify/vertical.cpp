#include "modify/vertical.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kFloorReach = 8;    // pixels to either side: a decimetre at 3 m
constexpr std::size_t kLeastNormals = 40;  // that agree, of some 1 500 places

/// The inverse of a depth is linear in the pixel on a plane, whatever its slant.
bool is_flat(float before, float here, float after) {
  constexpr float kBend = 0.02F;  // of the depth
  return std::abs(here / before + here / after - 2.0F) < kBend;
}

/// The normal of the surface at a pixel, away from the camera: down if it is a floor's. None on
/// edges.
std::optional<Eigen::Vector3f> floor_normal(const DepthView& depth, const PixelRays& rays,
                                            std::int64_t u, std::int64_t v) {
  const auto at = [&](std::int64_t column, std::int64_t row) {
    return depth.at(row * depth.cols + column);
  };
  const float here = at(u, v), left = at(u - kFloorReach, v), right = at(u + kFloorReach, v);
  const float above = at(u, v - kFloorReach), below = at(u, v + kFloorReach);
  for (const float z : {here, left, right, above, below}) {
    if (!(z > 0.0F)) return std::nullopt;
  }
  if (!is_flat(left, here, right) || !is_flat(above, here, below)) return std::nullopt;
  const Eigen::Vector3f across =
      lift(rays, u + kFloorReach, v, right) - lift(rays, u - kFloorReach, v, left);
  const Eigen::Vector3f along =
      lift(rays, u, v + kFloorReach, below) - lift(rays, u, v - kFloorReach, above);
  const Eigen::Vector3f normal = across.cross(along);
  const float length = normal.norm();
  if (!(length > 0.0F)) return std::nullopt;
  // Columns of a mirrored image run to the left.
  return normal / (normal.dot(lift(rays, u, v, here)) < 0.0F ? -length : length);
}

/// The direction that most normals share, from a first guess on; none if too few do.
std::optional<Eigen::Vector3f> shared(std::span<const Eigen::Vector3f> normals,
                                      Eigen::Vector3f guess) {
  constexpr int kSteps = 10;
  constexpr float kSpread = 0.14F;  // radians: of the Geman-McClure weight
  std::size_t agreeing = 0;
  for (int i = 0; i < kSteps; ++i) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    agreeing = 0;
    for (const Eigen::Vector3f& normal : normals) {
      const float off2 = (normal - guess).squaredNorm();
      const float share = 1.0F + off2 / (kSpread * kSpread);
      sum += normal / (share * share);
      agreeing += off2 < kSpread * kSpread;
    }
    if (!(sum.norm() > 0.0F)) return std::nullopt;
    guess = sum.normalized();
  }
  if (agreeing < kLeastNormals) return std::nullopt;
  return guess;
}

}  // namespace

void Vertical::learn(const DepthView& depth, const std::uint8_t* body_index, const PixelRays& rays,
                     const Eigen::Vector3f& hips) {
  constexpr std::uint8_t kNobody = 0xff;
  constexpr float kBelowHips = 0.25F;        // metres: seats and laps are higher
  constexpr float kHalfRight = 0.70710678F;  // cosine: tilted by more, walls look like floors
  constexpr double kLongest = 90.0;          // frames
  const auto places = static_cast<double>(depth.rows * depth.cols);
  const auto step = static_cast<std::int64_t>(std::ceil(std::sqrt(places / kMost)));
  const Eigen::Vector3f before = down_.cast<float>();
  const float lowest = before.dot(hips) + kBelowHips;
  std::size_t count = 0;
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (std::int64_t v = kFloorReach; v + kFloorReach < depth.rows; v += step) {
    for (std::int64_t u = kFloorReach; u + kFloorReach < depth.cols; u += step) {
      const std::int64_t pixel = v * depth.cols + u;
      if (body_index != nullptr && body_index[pixel] != kNobody) continue;
      const float z = depth.at(pixel);
      if (!(z > 0.0F) || !has_ray(rays, u, v)) continue;
      if (!(before.dot(lift(rays, u, v, z)) > lowest)) continue;
      const auto normal = floor_normal(depth, rays, u, v);
      if (!normal || !(normal->y() > kHalfRight) || count == kMost) continue;
      normals_[count++] = *normal;
      sum += *normal;
    }
  }
  if (count < kLeastNormals) return;
  const auto now = shared({normals_.data(), count}, sum.normalized());
  if (!now) return;
  frames_ = std::min(frames_ + 1.0, kLongest);
  down_ = (down_ + (now->cast<double>() - down_) / frames_).normalized();
}

}  // namespace manip3d
