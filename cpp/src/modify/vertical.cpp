#include "modify/vertical.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <span>
#include <utility>

#include "geometry/small_solvers.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kFloorReach = 8;  // pixels to either side; 10 cm at 3 m
constexpr std::size_t kMinNormals = 40;  // that agree, of some 1500 sampled pixels
constexpr float kSpread = 0.14F;         // radians; scale of the Geman-McClure weight

/// Whether three depths are on a plane: the inverse of the depth is linear in the pixel, whatever
/// the slant.
bool is_flat(float before, float here, float after) {
  constexpr float kBend = 0.02F;  // share of the depth
  return std::abs(here / before + here / after - 2.0F) < kBend;
}

/// The normal of the surface at a pixel, away from the camera, which is downwards on a floor. No
/// value on edges.
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

/// The direction on which most normals agree, starting from a first guess; no value if too few
/// agree.
std::optional<Eigen::Vector3f> shared(std::span<const Eigen::Vector3f> normals,
                                      Eigen::Vector3f guess) {
  constexpr int kSteps = 10;
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
  if (agreeing < kMinNormals) return std::nullopt;
  return guess;
}

constexpr float kLevel = 0.03F;  // metres; points of a level surface are this close to one height

/// The height of the lowest level surface of sufficient size; tables and steps are higher.
/// @param heights  Memory for the heights of the points.
std::optional<float> lowest_level(std::span<const Eigen::Vector3f> points,
                                  const Eigen::Vector3f& down, std::span<float> heights) {
  constexpr std::size_t kOneOf = 4;  // one of this many points at least must be on the floor
  for (std::size_t i = 0; i < points.size(); ++i) heights[i] = down.dot(points[i]);
  std::ranges::sort(heights, std::greater<>());
  const std::size_t least = std::max(kMinNormals / 2, heights.size() / kOneOf);
  for (std::size_t first = 0; first + least <= heights.size(); ++first) {
    if (heights[first] - heights[first + least - 1] < 2.0F * kLevel) {
      return heights[first + least / 2];
    }
  }
  return std::nullopt;
}

/// Fits the plane of the points, starting from a first guess; no value if they do not determine it.
std::optional<FloorPlane> fitted_plane(std::span<const Eigen::Vector3f> points, FloorPlane plane) {
  constexpr int kSteps = 5;
  // Square metres; the tilt of a narrower strip is undetermined.
  constexpr double kMinAcross = 0.02;
  for (int step = 0; step < kSteps; ++step) {
    // Moments about the mean, which separate the plane's tilt from its height.
    double sum = 0.0, squares = 0.0;
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    Eigen::Matrix3d moments = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3f& point : points) {
      const float off = plane.normal.dot(point) - plane.height;
      const double share = 1.0 + static_cast<double>(off * off / (kLevel * kLevel));
      const double weight = 1.0 / (share * share);
      const Eigen::Vector3d p = point.cast<double>();
      sum += weight;
      mean += weight * p;
      moments += weight * p * p.transpose();
      squares += weight * static_cast<double>(off * off);
    }
    if (!(sum > static_cast<double>(kMinNormals) / 2.0)) return std::nullopt;
    mean /= sum;
    const PrincipalAxes axes = principal_axes(moments / sum - mean * mean.transpose());
    if (!(axes.spreads[1] > kMinAcross)) return std::nullopt;
    Eigen::Vector3d normal = axes.directions.col(0);
    if (normal.dot(plane.normal.cast<double>()) < 0.0) normal = -normal;
    plane.normal = normal.cast<float>();
    plane.height = static_cast<float>(normal.dot(mean));
    plane.noise = static_cast<float>(std::sqrt(squares / sum));
  }
  return plane;
}

}  // namespace

void Vertical::learn(const DepthView& depth, const std::uint8_t* body_index, const PixelRays& rays,
                     const Eigen::Vector3f& hips) {
  constexpr float kBelowHips = 0.25F;        // metres; seats and laps are higher
  constexpr float kHalfRight = 0.70710678F;  // cosine; with a larger tilt, walls look like floors
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
      if (body_index != nullptr && body_index[pixel] != kNoBody) continue;
      const float z = depth.at(pixel);
      if (!(z > 0.0F) || !has_ray(rays, u, v)) continue;
      if (!(before.dot(lift(rays, u, v, z)) > lowest)) continue;
      const auto normal = floor_normal(depth, rays, u, v);
      if (!normal || !(normal->y() > kHalfRight) || count == kMost) continue;
      normals_[count] = *normal;
      points_[count++] = lift(rays, u, v, z);
      sum += *normal;
    }
  }
  if (count < kMinNormals) return;
  const auto now = shared({normals_.data(), count}, sum.normalized());
  if (!now) return;
  frames_ = std::min(frames_ + 1.0, kLongest);
  down_ = (down_ + (now->cast<double>() - down_) / frames_).normalized();
  find_floor(count, *now, hips);
}

/// Fits the plane of the floor to the `count` points of this frame with normals near `now`.
void Vertical::find_floor(std::size_t count, const Eigen::Vector3f& now,
                          const Eigen::Vector3f& hips) {
  constexpr float kNearPerson = 2.0F;  // metres; farther away, errors of the lens bend the floor
  std::size_t level = 0, near = 0;
  for (std::size_t i = 0; i < count; ++i) {
    if (!((normals_[i] - now).squaredNorm() < kSpread * kSpread)) continue;
    const Eigen::Vector3f from = points_[i] - hips;
    const bool is_near = (from - now.dot(from) * now).squaredNorm() < kNearPerson * kNearPerson;
    std::swap(points_[level], points_[i]);
    if (is_near) std::swap(points_[near++], points_[level]);
    ++level;
  }
  const std::size_t used = near >= kMinNormals ? near : level;
  const std::span<const Eigen::Vector3f> points(points_.data(), used);
  const auto lowest = lowest_level(points, now, {heights_.data(), used});
  if (!lowest) return;
  if (const auto fitted = fitted_plane(points, {now, *lowest, 0.0F})) floor_ = fitted;
}

}  // namespace manip3d
