#include "manip3d/modify/body_bones.hpp"

#include <algorithm>
#include <numbers>
#include <span>

#include "geometry/median.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

constexpr float of_girth(float metres) { return metres / (2.0F * std::numbers::pi_v<float>); }

// The mean adult: the mean of the means of men and of women, metres, to the nearest centimetre
// [Gordon et al., Natick/TR-15/007, 2012]; the thumb's breadth is from the survey of 1988.
constexpr float kStature = 1.69F;
constexpr float kBiceps = of_girth(0.33F), kForearm = of_girth(0.29F), kWrist = of_girth(0.17F);
constexpr float kHand = of_girth(0.20F), kThumb = 0.5F * 0.022F;
constexpr float kThigh = of_girth(0.62F), kKnee = of_girth(0.41F), kAnkle = of_girth(0.22F);
constexpr float kFoot = of_girth(0.24F), kNeckWidth = of_girth(0.36F), kHeadWidth = of_girth(0.57F);
constexpr float kChestBreadth = 0.28F, kChestDepth = 0.25F;
constexpr float kWaistBreadth = 0.31F, kWaistDepth = 0.23F;
/// From SpineShoulder, which is as high as the shoulder joints, up to the top of the breastbone.
constexpr float kBreastbone = 0.03F;

/// Added to the radii of a limb that is to be removed, beyond its root: a standard deviation of the
/// thigh's girth, because a strip of the limb that is left is more visible than a strip of the
/// trunk that is missing.
constexpr float kAllowance = of_girth(0.06F);

constexpr float mean_radius(float breadth, float depth) { return 0.25F * (breadth + depth); }
constexpr float kWaist = mean_radius(kWaistBreadth, kWaistDepth);
constexpr float kChest = mean_radius(kChestBreadth, kChestDepth);

/// By bone; right bones have the radii of left ones. Bones that meet at a joint of a limb have the
/// same radius there, so that their points are separated by the plane that bisects the angle
/// between them.
constexpr std::array<BoneRadii, kNumJoints> kMeanRadii = [] {
  std::array<BoneRadii, kNumJoints> radii{};
  const auto both_sides = [&](Joint left, const BoneRadii& r) {
    radii[static_cast<std::size_t>(left)] = r;
    radii[kMirroredJoints[static_cast<std::size_t>(left)]] = r;
  };
  both_sides(Joint::kSpineMid, {kWaist, kWaist});
  both_sides(Joint::kSpineShoulder, {kWaist, kChest});
  both_sides(Joint::kNeck, {kNeckWidth, kNeckWidth});
  both_sides(Joint::kHead, {kNeckWidth, kHeadWidth});
  both_sides(Joint::kShoulderLeft, {kBiceps, kBiceps});
  both_sides(Joint::kElbowLeft, {kBiceps, kForearm});
  both_sides(Joint::kWristLeft, {kForearm, kWrist});
  both_sides(Joint::kHandLeft, {kWrist, kHand});
  both_sides(Joint::kHandTipLeft, {kHand, kHand});
  both_sides(Joint::kThumbLeft, {0.0F, kThumb});  // the bone to the thumb starts within the palm
  both_sides(Joint::kHipLeft, {kThigh, kThigh});
  both_sides(Joint::kKneeLeft, {kThigh, kKnee});
  both_sides(Joint::kAnkleLeft, {kKnee, kAnkle});
  both_sides(Joint::kFootLeft, {kAnkle, kFoot});
  return radii;
}();

struct BoneLength {
  Joint joint;
  float share;  ///< Length as a share of the body's height.
};
/// Drillis & Contini, "Body segment parameters", 1966.
constexpr std::array kMeanLengths = {
    BoneLength{Joint::kElbowLeft, 0.186F}, BoneLength{Joint::kElbowRight, 0.186F},
    BoneLength{Joint::kWristLeft, 0.146F}, BoneLength{Joint::kWristRight, 0.146F},
    BoneLength{Joint::kKneeLeft, 0.245F},  BoneLength{Joint::kKneeRight, 0.245F},
    BoneLength{Joint::kAnkleLeft, 0.246F}, BoneLength{Joint::kAnkleRight, 0.246F}};

bool is_tracked(const Skeleton& skeleton, Joint joint) {
  return skeleton.state(joint) == TrackingState::kTracked && is_usable(skeleton, joint);
}

bool is_usable_bone(const Skeleton& skeleton, std::size_t bone) {
  return is_usable(skeleton, static_cast<Joint>(kJointParents[bone])) &&
         is_usable(skeleton, static_cast<Joint>(bone));
}

Joint farthest_tracked(const Skeleton& skeleton, Limb limb) {
  Joint farthest = limb_root(limb);
  for (const Joint joint : limb_chain(limb)) {
    if (is_tracked(skeleton, joint)) farthest = joint;
  }
  return farthest;
}

/// Ratio of a person's size to that of the mean adult; 0 if no bone is usable. The median tolerates
/// wrong joints of one missing limb.
float size_of(const Skeleton& skeleton) {
  std::array<float, kMeanLengths.size()> ratios{};
  std::size_t count = 0;
  for (const auto& [joint, share] : kMeanLengths) {
    const auto bone = static_cast<std::size_t>(joint);
    if (!is_usable_bone(skeleton, bone)) continue;
    const Eigen::Vector3f from = skeleton.positions[kJointParents[bone]];
    ratios[count++] = (skeleton[joint] - from).norm() / (share * kStature);
  }
  if (count == 0) return 0.0F;
  return median(std::span(ratios.data(), count));
}

class BoneBuilder {
 public:
  BoneBuilder(const Skeleton& skeleton, BoneRule rule, float trunk)
      : skeleton_(skeleton),
        rule_(rule),
        size_(rule == BoneRule::kSkin ? size_of(skeleton) : 0),
        trunk_size_(trunk * size_) {
    using enum Joint;
    has_rods_ = size_ > 0.0F;
    for (const Joint joint :
         {kSpineMid, kSpineShoulder, kShoulderLeft, kShoulderRight, kHipLeft, kHipRight}) {
      has_rods_ = has_rods_ && is_usable(skeleton, joint);
    }
  }

  void add_bone(std::size_t bone) {
    if (!is_usable_bone(skeleton_, bone)) return;
    if (has_rods_ && is_spine_bone(static_cast<std::uint8_t>(bone))) {
      add_rod(bone, 1.0F, Joint::kHipLeft);
      add_rod(bone, -1.0F, Joint::kHipRight);
    } else {
      bones_.add(skeleton_.positions[kJointParents[bone]], skeleton_.positions[bone], bone,
                 scaled(kMeanRadii[bone]));
    }
  }

  /// The line through the tracked joints of a limb, as segments of one label.
  void add_limb(Limb limb, const Mirror& mirror) {
    const Joint root = limb_root(limb), intact_root = limb_root(opposite(limb));
    const auto mirrored = [&](Joint joint) -> Eigen::Vector3f {
      return mirror(skeleton_[joint].cast<double>()).cast<float>();
    };
    const bool intact_usable = is_usable(skeleton_, intact_root);
    if (!is_usable(skeleton_, root) && !intact_usable) return;
    const Eigen::Vector3f from =
        is_usable(skeleton_, root) ? skeleton_[root] : mirrored(intact_root);
    if (farthest_tracked(skeleton_, limb) != root) {
      add_chain(limb, limb, from, [&](Joint joint) { return skeleton_[joint]; });
      add_thumb(limb);
    } else if (intact_usable) {
      const Eigen::Vector3f shift = from - mirrored(intact_root);
      add_missing(limb, from,
                  [&](Joint joint) -> Eigen::Vector3f { return mirrored(joint) + shift; });
    }
  }

  [[nodiscard]] const BoneSegments& bones() const { return bones_; }

 private:
  [[nodiscard]] BoneRadii scaled(const BoneRadii& mean) const {
    return {size_ * mean.start, size_ * mean.end};
  }

  /// One of two parallel segments of the trunk, from hip to waist or from waist to chest. Each is
  /// shifted to its side by half the breadth minus half the depth, so that both together are as
  /// broad and as deep as the trunk.
  void add_rod(std::size_t bone, float side, Joint hip) {
    using enum Joint;
    const Eigen::Vector3f across_chest =
        (skeleton_[kShoulderLeft] - skeleton_[kShoulderRight]).normalized();
    const Eigen::Vector3f across_hips = (skeleton_[kHipLeft] - skeleton_[kHipRight]).normalized();
    const float aside = 0.5F * side * trunk_size_;
    const Eigen::Vector3f waist =
        skeleton_[kSpineMid] +
        aside * (kWaistBreadth - kWaistDepth) * (across_chest + across_hips).normalized();
    if (bone == static_cast<std::size_t>(kSpineMid)) {
      bones_.add(skeleton_[hip], waist, bone, {size_ * kThigh, 0.5F * trunk_size_ * kWaistDepth});
      return;
    }
    const Eigen::Vector3f up = (skeleton_[kSpineShoulder] - skeleton_[kSpineMid]).normalized();
    const Eigen::Vector3f chest = skeleton_[kSpineShoulder] -
                                  size_ * (0.5F * kChestDepth - kBreastbone) * up +
                                  aside * (kChestBreadth - kChestDepth) * across_chest;
    bones_.add(waist, chest, bone,
               {0.5F * trunk_size_ * kWaistDepth, 0.5F * trunk_size_ * kChestDepth});
  }

  /// A segment of a limb that is to be removed. Over the segment at the root the allowance
  /// increases from 0 to its full value.
  void add_piece(Limb limb, const Eigen::Vector3f& from, const Eigen::Vector3f& to,
                 const BoneRadii& mean, bool from_root) {
    const float start = from_root ? mean.start : mean.start + kAllowance;
    bones_.add(from, to, limb_label(limb), scaled({start, mean.end + kAllowance}));
  }

  /// The tracked joints of limb `of`, moved by `place`, as segments of `limb`.
  template <typename Place>
  void add_chain(Limb limb, Limb of, Eigen::Vector3f from, const Place& place) {
    float radius = kMeanRadii[limb_label(of)].start;
    bool from_root = true;
    for (const Joint joint : limb_chain(of).subspan(1)) {
      if (!is_tracked(skeleton_, joint)) continue;
      const float end = kMeanRadii[static_cast<std::size_t>(joint)].end;
      const Eigen::Vector3f to = place(joint);
      add_piece(limb, from, to, {radius, end}, from_root);
      from = to;
      radius = end;
      from_root = false;
    }
  }

  void add_thumb(Limb limb) {
    for (std::size_t thumb = 1; is_arm(limb) && thumb < kNumJoints; ++thumb) {
      const auto parent = static_cast<Joint>(kJointParents[thumb]);
      const auto joint = static_cast<Joint>(thumb);
      const bool branches = is_limb_bone(limb, thumb) &&
                            std::ranges::find(limb_chain(limb), joint) == limb_chain(limb).end();
      if (branches && is_tracked(skeleton_, parent) && is_tracked(skeleton_, joint)) {
        add_piece(limb, skeleton_[parent], skeleton_[joint], kMeanRadii[thumb], false);
      }
    }
  }

  /// A limb of which only the root is tracked.
  template <typename Place>
  void add_missing(Limb limb, const Eigen::Vector3f& from, const Place& place) {
    const Limb intact = opposite(limb);
    const std::uint8_t label = limb_label(limb);
    const Joint end = farthest_tracked(skeleton_, intact);
    if (rule_ == BoneRule::kPaper || end == limb_root(intact)) {
      add_piece(limb, from, place(end), kMeanRadii[label], true);
      return;
    }
    add_chain(limb, intact, from, place);
    const auto first = static_cast<Joint>(limb_label(intact));
    if (!is_tracked(skeleton_, first) || !is_usable_bone(skeleton_, 1)) return;
    const Eigen::Vector3f moving = place(first) - from;
    const Eigen::Vector3f down =
        (skeleton_[Joint::kSpineBase] - skeleton_[Joint::kSpineMid]).normalized();
    const Eigen::Vector3f hanging = moving.norm() * down;
    add_piece(limb, from, from + hanging, kMeanRadii[label], true);
    add_piece(limb, from, from + 0.5F * (moving + hanging), kMeanRadii[label], true);
  }

  const Skeleton& skeleton_;
  BoneRule rule_;
  float size_, trunk_size_;
  bool has_rods_ = false;
  BoneSegments bones_;
};

}  // namespace

void BoneSegments::add(const Eigen::Vector3f& from, const Eigen::Vector3f& to, std::size_t number,
                       const BoneRadii& thickness) {
  start[count] = from;
  end[count] = to;
  radii[count] = thickness;
  label[count++] = static_cast<std::uint8_t>(number);
}

BoneSegments body_bones(const Skeleton& skeleton, BoneRule rule, float trunk) {
  BoneBuilder builder(skeleton, rule, trunk);
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) builder.add_bone(bone);
  return builder.bones();
}

BoneSegments body_bones(const Skeleton& skeleton, BoneRule rule, Limb collapsed,
                        const Mirror& mirror, float trunk) {
  BoneBuilder builder(skeleton, rule, trunk);
  for (std::size_t bone = 1; bone < kNumJoints; ++bone) {
    if (bone == limb_label(collapsed)) builder.add_limb(collapsed, mirror);
    if (!is_limb_bone(collapsed, bone)) builder.add_bone(bone);
  }
  return builder.bones();
}

}  // namespace manip3d
