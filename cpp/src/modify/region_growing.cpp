#include "manip3d/modify/region_growing.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
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

/// Distances from points to the segments of one bone.
class BoneDistances {
 public:
  explicit BoneDistances(const BoneSegments& bones) : table_(bones) {
    for (std::size_t i = 0; i < table_.count; ++i) {  // Segments of one label are contiguous.
      const auto label = static_cast<std::size_t>(table_.label[i]);
      if (count_[label]++ == 0) first_[label] = static_cast<std::uint8_t>(i);
    }
  }

  struct Distance {
    float judged = kUnreached;   ///< Measure of how near the skin is (BoneTable::judged()).
    float squared = kUnreached;  ///< To the line of the bone.
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

/// Maps floats to integers in the same order, including negative floats.
std::uint32_t ordered(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  return (bits >> 31) != 0 ? ~bits : bits | 0x80000000U;
}

/// A heap of four children a node: half as deep as a binary heap, and siblings are contiguous.
class LeastFirst {
 public:
  LeastFirst() : keys_(kChildren, kNone) {}
  void reserve(std::size_t count) { keys_.reserve(count + kChildren); }
  [[nodiscard]] bool empty() const { return size_ == 0; }

  /// @param key  Must not have all bits set.
  void push(std::uint64_t key) {
    keys_.push_back(kNone);
    std::size_t at = size_++;
    for (; at > 0 && key < keys_[parent(at)]; at = parent(at)) keys_[at] = keys_[parent(at)];
    keys_[at] = key;
  }

  /// Removes and returns the smallest key.
  std::uint64_t pop() {
    const std::uint64_t least = keys_[0], key = keys_[--size_];
    keys_[size_] = kNone;
    keys_.pop_back();
    std::size_t at = 0;
    for (std::size_t child = 1; child < size_; child = kChildren * at + 1) {
      const std::uint64_t* keys = &keys_[child];  // The keys after the last one are kNone.
      const std::size_t one = keys[1] < keys[0] ? 1 : 0, other = keys[3] < keys[2] ? 3 : 2;
      const std::size_t best = child + (keys[other] < keys[one] ? other : one);
      if (!(keys_[best] < key)) break;
      keys_[at] = keys_[best];
      at = best;
    }
    if (size_ > 0) keys_[at] = key;
    return least;
  }

 private:
  static constexpr std::size_t kChildren = 4;
  static constexpr std::uint64_t kNone = ~std::uint64_t{0};
  static std::size_t parent(std::size_t at) { return (at - 1) / kChildren; }

  std::vector<std::uint64_t> keys_;  ///< Followed by four kNone.
  std::size_t size_ = 0;
};

/// Labels that spread over a person's points.
class Flood {
 public:
  Flood(const BoneDistances& bones, const DepthStep& step, PersonPoints& points)
      : bones_(bones),
        step_(step),
        points_(points),
        stride_(points.box.width + 2),
        point_at_(static_cast<std::size_t>(stride_ * (points.box.height + 2)), kNoPoint),
        place_(points.count),
        offered_(points.count, kNothing),
        offer_(points.count, 0) {
    for (std::int64_t i = 0; i < points.count; ++i) {
      const std::int64_t at = place(points.pixel[i] % points.cols, points.pixel[i] / points.cols);
      place_[i] = static_cast<std::int32_t>(at);
      point_at_[at] = static_cast<std::int32_t>(i);
      points.label[i] = 0;
      points.squared_distance[i] = points.skin_distance[i] = kUnreached;
    }
    queue_.reserve(static_cast<std::size_t>(2 * points.count));
  }

  void seed(std::int64_t u, std::int64_t v, std::size_t label) {
    const PixelBox& box = points_.box;
    if (u < box.u0 || v < box.v0 || u >= box.u0 + box.width || v >= box.v0 + box.height) return;
    const std::int32_t point = point_at_[place(u, v)];
    if (point != kNoPoint) offer(point, label);
  }

  /// Spreads labels within contours until no label can spread further.
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

  [[nodiscard]] std::int64_t place(std::int64_t u, std::int64_t v) const {
    return (v - points_.box.v0 + 1) * stride_ + u - points_.box.u0 + 1;
  }

  /// Offers a point to a bone. The queue holds the best offer to each point.
  void offer(std::int32_t point, std::size_t label) {
    if (points_.label[point] != 0) return;
    // Another neighbour offered the same.
    if (offered_[point] != kNothing && offer_[point] == label) return;
    const auto d = bones_.to(label, points_.x[point], points_.y[point], points_.z[point]);
    // Only reach_ may be infinite: a bone with seeds has usable joints, which are within 100 m.
    if (!(d.skin <= reach_)) return;
    const std::uint32_t rank = ordered(d.judged);
    const bool better =
        rank < offered_[point] || (rank == offered_[point] && label < offer_[point]);
    if (!better) return;
    const bool is_new = rank != offered_[point];
    offered_[point] = rank;
    offer_[point] = static_cast<std::uint8_t>(label);
    points_.squared_distance[point] = d.squared;  // All points in the queue get a label in the end.
    points_.skin_distance[point] = d.skin;
    if (is_new) queue_.push((std::uint64_t{rank} << 32) | static_cast<std::uint32_t>(point));
  }

  void run() {
    while (!queue_.empty()) {
      const std::uint64_t first = queue_.pop();
      const auto point = static_cast<std::int32_t>(first & 0xffffffffU);
      // A better offer came first.
      if (points_.label[point] != 0 || offered_[point] != first >> 32) continue;
      take(point, offer_[point]);
    }
  }

  void take(std::int32_t point, std::uint8_t label) {
    points_.label[point] = label;
    const std::int32_t* here = &point_at_[place_[point]];
    pass_on(point, here[-stride_], label);
    pass_on(point, here[-1], label);
    pass_on(point, here[1], label);
    pass_on(point, here[stride_], label);
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
  std::int64_t stride_;
  /// Point of each pixel of the box, with a border of kNoPoint around it.
  std::vector<std::int32_t> point_at_;
  std::vector<std::int32_t> place_;     ///< By point: its index in `point_at_`.
  std::vector<std::uint32_t> offered_;  ///< By point: rank of the best offer so far.
  std::vector<std::uint8_t> offer_;     ///< By point: bone of that offer.
  LeastFirst queue_;                    ///< Ranks and points.
  std::vector<Blocked> blocked_;        ///< Offers across a contour.
  float reach_ = kUnreached;
  bool crosses_ = false;
};

/// Seeds the pixels under a bone, or the pixel under its middle.
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
  constexpr double kLongest = 4.0 * kMaxImageSide;  // pixels; longer if a joint is beside the lens
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
  throw InputError("reach, surface_reach: expected >= 0, got " + number_text(o.reach) + " and " +
                   number_text(o.surface_reach));
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
