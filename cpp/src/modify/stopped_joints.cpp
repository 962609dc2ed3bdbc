#include "modify/stopped_joints.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace manip3d {
namespace {

// Seconds; a tracker of 10 Hz repeats its joints in three frames at 30 Hz.
constexpr double kMinTime = 0.15;
// Share of the points that must have moved. An arm has 6 to 8 % of them, a flickering border none.
constexpr double kMaxMoved = 0.01;
constexpr float kSamePlace = 0.03F;  // metres; breathing moves a chest by as much
constexpr std::int64_t kReach = 2;   // pixels: borders flicker
constexpr std::int64_t kEvery = 5;   // one of this many points is tested

bool are_same(const Skeleton& a, const Skeleton& b) {
  return a.id == b.id && a.states == b.states && a.positions == b.positions;
}

}  // namespace

void StoppedJoints::reset() { is_known_ = is_repeated_ = are_stopped_ = false; }

void StoppedJoints::learn(const Skeleton& reported, const PersonPoints& points, double time_s) {
  if (!is_known_ || !are_same(reported, reported_)) {
    reported_ = reported;
    since_s_ = time_s;
    is_known_ = true;
    is_repeated_ = are_stopped_ = false;
    return;
  }
  if (!is_repeated_) {
    remember(points);
    is_repeated_ = true;
  } else if (!are_stopped_ && time_s - since_s_ > kMinTime) {
    are_stopped_ = moved_share(points) > kMaxMoved;
  }
}

void StoppedJoints::remember(const PersonPoints& points) {
  std::ranges::fill(depth_, 0.0F);
  for (std::int64_t i = 0; i < points.count; ++i) depth_[points.pixel[i]] = points.z[i];
}

/// Share of the points at whose place no point was before.
double StoppedJoints::moved_share(const PersonPoints& points) const {
  std::int64_t moved = 0, asked = 0;
  for (std::int64_t i = 0; i < points.count; i += kEvery) {
    const std::int64_t u = points.pixel[i] % points.cols, v = points.pixel[i] / points.cols;
    bool was_there = false;
    for (std::int64_t y = std::max<std::int64_t>(0, v - kReach);
         y <= std::min(points.rows - 1, v + kReach) && !was_there; ++y) {
      for (std::int64_t x = std::max<std::int64_t>(0, u - kReach);
           x <= std::min(points.cols - 1, u + kReach) && !was_there; ++x) {
        was_there = std::abs(depth_[y * points.cols + x] - points.z[i]) < kSamePlace;
      }
    }
    moved += !was_there;
    ++asked;
  }
  return asked > 0 ? static_cast<double>(moved) / static_cast<double>(asked) : 0.0;
}

}  // namespace manip3d
