#include "manip3d/modify/region_growing.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "modify/bone_table.hpp"

namespace manip3d {
namespace {

constexpr float kUnreached = std::numeric_limits<float>::infinity();
constexpr std::int32_t kNoPoint = -1;

/// Distances from points to the pieces of one bone.
class BoneDistances {
 public:
  explicit BoneDistances(const BoneSegments& bones) : table_(bones) {
    for (std::size_t i = 0; i < table_.count; ++i) {  // pieces of one label stand together
      const auto label = static_cast<std::size_t>(table_.label[i]);
      if (count_[label]++ == 0) first_[label] = static_cast<std::uint8_t>(i);
    }
  }

  struct Distance {
    float judged = kUnreached;   ///< Judges the nearness of the skin.
    float squared = kUnreached;  ///< To the bone itself.
    float skin = kUnreached;     ///< To the skin.
  };
  [[nodiscard]] Distance to(std::size_t label, float x, float y, float z) const {
    Distance best;
    for (std::size_t i = first_[label]; i < std::size_t{first_[label]} + count_[label]; ++i) {
      float along;
      const float squared = table_.squared_distance(i, x, y, z, along);
      const float distance = std::sqrt(squared);
      const float judged = table_.judged(i, distance, along);
      if (judged < best.judged) {
        best = {judged, squared, distance - (table_.radius[i] + along * table_.taper[i])};
      }
    }
    return best;
  }

 private:
  BoneTable table_;
  std::array<std::uint8_t, kNumJoints> first_{}, count_{};
};

/// Floats as integers of the same order, negative ones included.
std::uint32_t ordered(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  return (bits >> 31) != 0 ? ~bits : bits | 0x80000000U;
}

/// Labels that spread over a person's points.
class Flood {
 public:
  Flood(const BoneDistances& bones, const DepthStep& step, PersonPoints& points)
      : bones_(bones),
        step_(step),
        points_(points),
        point_at_(static_cast<std::size_t>(points.rows * points.cols), kNoPoint),
        offered_(static_cast<std::size_t>(points.count), kNothing),
        offer_(static_cast<std::size_t>(points.count), 0) {
    for (std::int64_t i = 0; i < points.count; ++i) {
      point_at_[points.pixel[i]] = static_cast<std::int32_t>(i);
      points.label[i] = 0;
      points.squared_distance[i] = points.skin_distance[i] = kUnreached;
    }
    queue_.reserve(static_cast<std::size_t>(2 * points.count));
  }

  void seed(std::int64_t u, std::int64_t v, std::size_t label) {
    if (u < 0 || v < 0 || u >= points_.cols || v >= points_.rows) return;
    const std::int32_t point = point_at_[v * points_.cols + u];
    if (point != kNoPoint) offer(point, label);
  }

  /// Until no label can spread any more.
  void spread_within_contours(float reach) {
    reach_ = reach;
    crosses_ = false;
    run();
  }
  void spread_beyond_contours(float reach) {
    reach_ = reach;
    crosses_ = true;
    std::fill(offered_.begin(), offered_.end(), kNothing);
    for (const Blocked& b : blocked_) offer(b.point, b.label);
    run();
  }

 private:
  static constexpr std::uint32_t kNothing = 0xffffffffU;
  struct Blocked {
    std::int32_t point;
    std::uint8_t label;
  };

  /// A point may become a bone's; the best offer to each point stands in the queue.
  void offer(std::int32_t point, std::size_t label) {
    if (points_.label[point] != 0) return;
    const auto d = bones_.to(label, points_.x[point], points_.y[point], points_.z[point]);
    if (!(d.skin <= reach_)) return;
    const std::uint32_t rank = ordered(d.judged);
    const bool better =
        rank < offered_[point] || (rank == offered_[point] && label < offer_[point]);
    if (!better) return;
    const bool is_new = rank != offered_[point];
    offered_[point] = rank;
    offer_[point] = static_cast<std::uint8_t>(label);
    if (!is_new) return;
    queue_.push_back((std::uint64_t{rank} << 32) | static_cast<std::uint32_t>(point));
    std::push_heap(queue_.begin(), queue_.end(), std::greater<>());
  }

  void run() {
    while (!queue_.empty()) {
      const std::uint64_t first = queue_.front();
      std::pop_heap(queue_.begin(), queue_.end(), std::greater<>());
      queue_.pop_back();
      const auto point = static_cast<std::int32_t>(first & 0xffffffffU);
      if (points_.label[point] != 0 || offered_[point] != first >> 32) continue;  // outbid
      take(point, offer_[point]);
    }
  }

  void take(std::int32_t point, std::uint8_t label) {
    const auto d = bones_.to(label, points_.x[point], points_.y[point], points_.z[point]);
    points_.label[point] = label;
    points_.squared_distance[point] = d.squared;
    points_.skin_distance[point] = d.skin;
    const std::int64_t pixel = points_.pixel[point];
    const std::int64_t u = pixel % points_.cols, v = pixel / points_.cols;
    if (v > 0) pass_on(point, point_at_[pixel - points_.cols], label);
    if (u > 0) pass_on(point, point_at_[pixel - 1], label);
    if (u + 1 < points_.cols) pass_on(point, point_at_[pixel + 1], label);
    if (v + 1 < points_.rows) pass_on(point, point_at_[pixel + points_.cols], label);
  }

  void pass_on(std::int32_t from, std::int32_t to, std::uint8_t label) {
    if (to == kNoPoint || points_.label[to] != 0) return;
    const auto [near, far] = std::minmax(points_.z[from], points_.z[to]);
    if (crosses_ || step_.connects(near, far)) {
      offer(to, label);
    } else {
      blocked_.push_back({to, label});
    }
  }

  const BoneDistances& bones_;
  const DepthStep& step_;
  PersonPoints& points_;
  std::vector<std::int32_t> point_at_;
  std::vector<std::uint32_t> offered_;  ///< By point: rank of the best offer so far.
  std::vector<std::uint8_t> offer_;     ///< Its bone.
  std::vector<std::uint64_t> queue_;    ///< Rank and point; a heap, the least first.
  std::vector<Blocked> blocked_;        ///< Offers that met a contour.
  float reach_ = kUnreached;
  bool crosses_ = false;
};

/// The pixels under a bone, or the one under its middle.
void seed_bone(const Skeleton& skeleton, const Intrinsics& camera, std::size_t bone, bool line,
               Flood& flood) {
  const auto parent = static_cast<Joint>(kJointParents[bone]);
  const auto joint = static_cast<Joint>(bone);
  if (!is_usable(skeleton, parent) || !is_usable(skeleton, joint)) return;
  const Eigen::Vector3d a = skeleton[parent].cast<double>(), b = skeleton[joint].cast<double>();
  if (!line) {
    const Eigen::Vector2d middle = project(camera, 0.5 * (a + b));
    if (middle.allFinite()) flood.seed(std::llround(middle.x()), std::llround(middle.y()), bone);
    return;
  }
  const Eigen::Vector2d from = project(camera, a), to = project(camera, b);
  if (!from.allFinite() || !to.allFinite()) return;
  const double length = (to - from).cwiseAbs().maxCoeff();
  constexpr double kLongest = 4.0 * kMaxImageSide;  // a joint beside the lens
  if (!(length < kLongest)) return;
  const auto steps = static_cast<std::int64_t>(std::ceil(length)) + 1;
  for (std::int64_t i = 0; i <= steps; ++i) {
    const Eigen::Vector2d at =
        from + (static_cast<double>(i) / static_cast<double>(steps)) * (to - from);
    flood.seed(std::llround(at.x()), std::llround(at.y()), bone);
  }
}

void check(const RegionOptions& o) {
  if (o.reach >= 0.0 && o.surface_reach >= 0.0) return;
  throw InputError("reach, surface_reach: expected >= 0, got " + std::to_string(o.reach) + " and " +
                   std::to_string(o.surface_reach));
}

}  // namespace

void grow_bones(const Skeleton& skeleton, const Intrinsics& camera, bool by_index,
                const RegionOptions& options, PersonPoints& points) {
  check(options);
  const DepthStep step(options.step, camera.fx);
  const BoneDistances bones(body_bones(skeleton, BoneRule::kSkin));
  Flood flood(bones, step, points);
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    seed_bone(skeleton, camera, bone, options.line_seeds, flood);
  }
  flood.spread_within_contours(by_index ? kUnreached : static_cast<float>(options.surface_reach));
  flood.spread_beyond_contours(static_cast<float>(options.reach));
}

}  // namespace manip3d
