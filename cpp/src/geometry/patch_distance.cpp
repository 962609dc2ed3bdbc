#include "manip3d/geometry/patch_distance.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "geometry/constants.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kMaxOverlaid = 16;  // largest number of candidates that are cut against each other
// Largest number of parts of a triangle; with more, it is halved instead.
constexpr std::size_t kMaxParts = 64;
constexpr int kMaxDepth = 24;            // largest number of successive halvings
constexpr double kSmallestPart = 0.125;  // share of the limit; smaller parts are treated as points
constexpr double kEdgeOn = 1e-12;  // squared sine; a triangle seen edge-on cannot be cut along

double squared_distance_to_segment(const Vector3d& p, const Vector3d& a, const Vector3d& b) {
  const Vector3d ab = b - a;
  const double squared_length = ab.squaredNorm();
  const double t = squared_length > 0.0 ? std::clamp(ab.dot(p - a) / squared_length, 0.0, 1.0) : 0;
  return (p - (a + t * ab)).squaredNorm();
}

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

// The first corner of the longest edge; the first of equally long ones.
int longest_edge(const Triangle3& triangle) {
  int longest = 0;
  double squared_length = 0.0;
  for (int k = 0; k < 3; ++k) {
    const double squared = (triangle[(k + 1) % 3] - triangle[k]).squaredNorm();
    if (squared > squared_length) {
      squared_length = squared;
      longest = k;
    }
  }
  return longest;
}

}  // namespace

double distance(const Vector3d& p, const Triangle3& t) {
  const Vector3d ab = t[1] - t[0];
  const Vector3d ac = t[2] - t[0];
  const Vector3d ap = p - t[0];
  const Vector3d normal = ab.cross(ac);
  const double squared_normal = normal.squaredNorm();
  if (squared_normal > 0.0) {
    const double b = normal.dot(ap.cross(ac)) / squared_normal;
    const double c = normal.dot(ab.cross(ap)) / squared_normal;
    // With such weights, the computed point is inside the triangle despite rounding, so that the
    // distance from it is never too small.
    if (b >= 0.0 && c >= 0.0 && b + c <= 1.0) return (ap - b * ab - c * ac).norm();
  }
  return std::sqrt(std::min({squared_distance_to_segment(p, t[0], t[1]),
                             squared_distance_to_segment(p, t[1], t[2]),
                             squared_distance_to_segment(p, t[2], t[0])}));
}

PatchDistance::Box PatchDistance::box_of(const Triangle3& t) {
  return {t[0].array().min(t[1].array()).min(t[2].array()),
          t[0].array().max(t[1].array()).max(t[2].array())};
}

double PatchDistance::bound(const Triangle3& triangle, std::span<const PatchTriangle> patch,
                            double limit) {
  patch_ = patch;
  limit_ = limit;
  used_.clear();
  boxes_.clear();
  candidates_.clear();
  for (const PatchTriangle& other : patch) {
    boxes_.push_back(box_of(other.corners));
    candidates_.push_back({static_cast<std::int32_t>(candidates_.size()), 0.0});
  }
  const double result = bound_within(triangle, 0, candidates_.size(), 0);
  std::sort(used_.begin(), used_.end());
  used_.erase(std::unique(used_.begin(), used_.end()), used_.end());
  return result;
}

/// Pushes those of the candidates from `begin` to `end` that may be within the limit of the
/// triangle, the nearest first. Returns false if some corner is within the limit of none.
bool PatchDistance::push_near(const Triangle3& triangle, std::size_t begin, std::size_t end) {
  const Box box = box_of(triangle);
  const auto first = static_cast<std::ptrdiff_t>(candidates_.size());
  std::array<double, 3> nearest;
  nearest.fill(kInfinity);
  for (std::size_t i = begin; i < end; ++i) {
    const std::int32_t index = candidates_[i].index;
    const Box& other = boxes_[index];
    if (((other.min - box.max).max(box.min - other.max) > limit_).any()) continue;
    double farthest = 0.0;
    for (int k = 0; k < 3; ++k) {
      const double d = distance(triangle[k], patch_[index].corners) + patch_[index].error;
      nearest[k] = std::min(nearest[k], d);
      farthest = std::max(farthest, d);
    }
    candidates_.push_back({index, farthest});
  }
  if (*std::max_element(nearest.begin(), nearest.end()) > limit_) return false;
  const auto by_distance = [](const Candidate& a, const Candidate& b) {
    return a.farthest < b.farthest || (a.farthest == b.farthest && a.index < b.index);
  };
  std::sort(candidates_.begin() + first, candidates_.end(), by_distance);
  return true;
}

double PatchDistance::bound_within(const Triangle3& triangle, std::size_t begin, std::size_t end,
                                   int depth) {
  const std::size_t first = candidates_.size();
  const auto give_up = [&] {
    candidates_.resize(first);
    return kInfinity;
  };
  if (!push_near(triangle, begin, end)) return give_up();
  const auto count = static_cast<int>(candidates_.size() - first);
  const Candidate best = candidates_[first];
  double result = best.farthest;
  const std::size_t num_used = used_.size();
  used_.push_back(best.index);
  // A bound near the limit would leave no margin for later collapses.
  if (result > 0.5 * limit_ && count > 1 && count <= kMaxOverlaid) {
    used_.pop_back();
    const double overlaid = overlay(triangle, first);
    if (overlaid < result) {
      result = overlaid;
    } else {
      used_.resize(num_used);
      used_.push_back(best.index);
    }
  }
  if (result <= limit_) {
    candidates_.resize(first);
    return result;
  }
  used_.resize(num_used);
  const int longest = longest_edge(triangle);
  const Vector3d &from = triangle[longest], &to = triangle[(longest + 1) % 3];
  // The bound against one triangle is exact; halving would not improve it.
  if (count == 1 || depth == kMaxDepth ||
      (to - from).squaredNorm() < std::pow(kSmallestPart * limit_, 2)) {
    return give_up();
  }
  const std::size_t until = candidates_.size();
  for (const int corner : {longest, (longest + 1) % 3}) {
    Triangle3 half = triangle;
    half[corner] = 0.5 * (from + to);
    const double of_half = bound_within(half, first, until, depth + 1);
    if (of_half > limit_) return give_up();
    result = corner == longest ? of_half : std::max(result, of_half);
  }
  candidates_.resize(first);
  return result;
}

/// Cuts `polygon` along a line; `inside` is the part to its left if `orientation` > 0. Returns
/// false if a part has too many corners.
bool PatchDistance::cut(const Polygon& polygon, const Vector2d& from, const Vector2d& to,
                        double orientation, Polygon& inside, Polygon& outside) {
  inside.size = outside.size = 0;
  std::array<double, Polygon::kCapacity> side;
  bool any_inside = false, any_outside = false;
  for (int i = 0; i < polygon.size; ++i) {
    side[i] = orientation * cross(to - from, polygon.corners[i] - from);
    any_inside |= side[i] > 0.0;
    any_outside |= side[i] < 0.0;
  }
  if (!any_outside || !any_inside) {
    (any_outside ? outside : inside) = polygon;
    return true;
  }
  if (polygon.size + 2 > Polygon::kCapacity) return false;
  const auto add = [](Polygon& part, const Vector2d& p) { part.corners[part.size++] = p; };
  for (int i = 0; i < polygon.size; ++i) {
    const int j = (i + 1) % polygon.size;
    const Vector2d& p = polygon.corners[i];
    if (side[i] >= 0.0) add(inside, p);
    if (side[i] <= 0.0) add(outside, p);
    if ((side[i] < 0.0 && side[j] > 0.0) || (side[i] > 0.0 && side[j] < 0.0)) {
      // Both parts get the same point, so that there is no gap between them.
      const double t = side[i] / (side[i] - side[j]);
      const Vector2d crossing = p + t * (polygon.corners[j] - p);
      add(inside, crossing);
      add(outside, crossing);
    }
  }
  return true;
}

double PatchDistance::farthest(const Polygon& polygon, const Frame& frame,
                               const PatchTriangle& other) const {
  double result = 0.0;
  for (int i = 0; i < polygon.size; ++i) {
    result = std::max(result, distance(frame.lift(polygon.corners[i]), other.corners));
  }
  return result + other.error;
}

/// Proves the part of `polygon` that lies below or above `other`; moves the rest to next_.
void PatchDistance::subtract(const Polygon& polygon, const std::array<Vector2d, 3>& corners,
                             double orientation, const Frame& frame, const PatchTriangle& other,
                             double& worst, bool& is_used) {
  const std::size_t first = next_.size();
  Polygon inside = polygon, remaining, outside;
  for (int k = 0; k < 3; ++k) {
    if (!cut(inside, corners[k], corners[(k + 1) % 3], orientation, remaining, outside)) {
      remaining.size = 0;
    }
    if (remaining.size == 0) break;
    if (outside.size > 0) next_.push_back(outside);
    inside = remaining;
  }
  const double bound = remaining.size > 0 ? farthest(inside, frame, other) : kInfinity;
  if (bound <= limit_) {
    worst = std::max(worst, bound);
    is_used = true;
  } else {
    next_.resize(first);
    next_.push_back(polygon);
  }
}

/// The bound from cutting the triangle along the edges of the candidates from `begin` on.
double PatchDistance::overlay(const Triangle3& triangle, std::size_t begin) {
  const Vector3d ab = triangle[1] - triangle[0];
  const Vector3d normal = ab.cross(triangle[2] - triangle[0]);
  if (!(normal.norm() > 0.0)) return kInfinity;
  Frame frame{triangle[0], ab.normalized(), Vector3d::Zero()};
  frame.v = normal.normalized().cross(frame.u);
  rest_.clear();
  Polygon& whole = rest_.emplace_back();
  for (const Vector3d& corner : triangle) whole.corners[whole.size++] = frame.project(corner);
  double worst = 0.0;
  for (std::size_t i = begin; i < candidates_.size() && !rest_.empty(); ++i) {
    const PatchTriangle& other = patch_[candidates_[i].index];
    std::array<Vector2d, 3> corners;
    for (int k = 0; k < 3; ++k) corners[k] = frame.project(other.corners[k]);
    const Vector2d first = corners[1] - corners[0], second = corners[2] - corners[0];
    const double area = cross(first, second);
    if (!(area * area > kEdgeOn * first.squaredNorm() * second.squaredNorm())) continue;
    bool is_used = false;
    next_.clear();
    for (const Polygon& polygon : rest_) {
      subtract(polygon, corners, std::copysign(1.0, area), frame, other, worst, is_used);
    }
    if (is_used) used_.push_back(candidates_[i].index);
    rest_.swap(next_);
    if (rest_.size() > kMaxParts) return kInfinity;
  }
  for (const Polygon& polygon : rest_) {  // parts outside the patch
    double least = kInfinity;
    std::int32_t nearest = -1;
    for (std::size_t i = begin; i < candidates_.size(); ++i) {
      const double d = farthest(polygon, frame, patch_[candidates_[i].index]);
      if (d < least) {
        least = d;
        nearest = candidates_[i].index;
      }
    }
    if (least > limit_) return kInfinity;
    worst = std::max(worst, least);
    used_.push_back(nearest);
  }
  return worst;
}

}  // namespace manip3d
