#include "modify/phantom_quality.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "manip3d/modify/joint_smoother.hpp"
#include "modify/nearest_skin.hpp"
#include "modify/ray_at.hpp"

namespace manip3d {
namespace {

// The limits at which a frame is degraded. They were chosen on UTD-MHAD trials of both halves
// (kMaxLeft, kMaxLostLegs and kMaxLostTrunk: only on the tuning half of
// benchmarks/bench_people.py), so rates that are measured on those trials do not hold for other
// people.
constexpr double kMaxPlane = 6.0;    // degrees; it displaces a hand 0.3 m from the plane by 6 cm
constexpr double kMaxAcross = 0.03;  // metres; an extended leg ends 0.8 m from the plane's origin
constexpr double kMaxLeap = 0.12;    // metres in one frame
constexpr double kMaxGapArm = 0.10,
                 kMaxGapLeg = 0.16;  // metres; a hip lies deeper in the body than a shoulder
constexpr double kMinLargest = 0.7;  // share of the phantom's pixels
// Legs: a loss of 15 % looks wrong; the limit is lower because the hips' place follows from joints,
// which err.
constexpr double kMaxLostLegs = 0.14, kMaxLostTrunk = 0.05;
constexpr double kMaxLeft = 0.10;  // share of the affected limb's pixels
// Chosen on simulated people with and without sleeves (seeds 0 and 1), and on the tuning half with
// inferred joints of the affected limb.
constexpr double kMaxCloth = 0.05;  // share of the intact limb's pixels
// Pixels; for small limbs, single pixels would be a large share.
constexpr double kMinLimb = 250.0;

// Chosen on the tuning half.
constexpr double kMaxStray = 0.2;                          // share of the intact arm's pixels
constexpr float kBesideArm = 0.08F, kBesideTrunk = 0.15F;  // metres from the skin of every bone
constexpr float kAside = 0.20F;                            // metres from the plane of symmetry
constexpr float kAboveHips = 0.10F, kBehindBone = 0.05F;   // metres

constexpr double kMaxOutside = 0.5;  // share of the mirrored points

constexpr float kAwayFromRoot = 0.10F;  // metres; nearer to the root, a stump may be visible
// Metres; points this far behind all joints of a limb do not belong to it.
constexpr float kBehind = 0.15F;

double share_of(std::int64_t part, std::int64_t all) {
  return all > 0 ? static_cast<double>(part) / static_cast<double>(all) : 0.0;
}

/// Pixels of the body above the hips that lie too far from every bone to belong to it, as those of
/// an arm whose joints are elsewhere, relative to the pixels of the intact arm. Pixels nearest to a
/// leg do not count, because the thighs of seated people rise above their joints. The limit is
/// larger near the trunk, because people who lean forward have their back and head far from its
/// bones and hats are high. Pixels behind the bone may be those of a chair.
double stray_share(const PersonPoints& points, Limb affected, const Skeleton& person,
                   const BoneSegments& bones, const Girth& girth, const BodyFrame& frame,
                   const PhantomImage& image) {
  if (!is_usable(person, Joint::kSpineBase)) return 0.0;
  const Eigen::Vector3f hips = person[Joint::kSpineBase], up = frame.y.cast<float>();
  const float stout = girth.around_trunk();
  const auto is_above = [&](const Eigen::Vector3f& p) {
    return hips.y() - p.y() > kAboveHips && up.dot(p - hips) > kAboveHips;
  };
  const Eigen::Vector3f n = frame.n.cast<float>(), origin = frame.origin.cast<float>();
  const auto is_beside = [&](const Eigen::Vector3f& p, const NearestSkin& nearest) {
    const auto is_of = [&](Limb limb) { return is_limb_bone(limb, nearest.label); };
    if (is_of(Limb::kLeftLeg) || is_of(Limb::kRightLeg)) return false;
    if (is_of(Limb::kLeftArm) || is_of(Limb::kRightArm)) return true;
    return nearest.distance > stout + kBesideTrunk && std::abs(n.dot(p - origin)) > kAside;
  };
  std::int64_t intact = 0, stray = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    intact += is_limb_bone(opposite(affected), points.label[i]);
    if (!(points.skin_distance[i] > stout + kBesideArm)) continue;
    if (image.kind[points.pixel[i]] != PixelKind::kBody) continue;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    if (!is_above(p)) continue;
    const NearestSkin nearest = nearest_skin(p, bones, [](std::uint8_t) { return true; });
    stray += is_beside(p, nearest) && p.z() < nearest.on_bone.z() + kBehindBone;
  }
  return static_cast<double>(stray) / std::max(kMinLimb, static_cast<double>(intact));
}

/// Whether the camera would see the trunk in the direction of p if nothing were in front of it.
bool shows_trunk(const Eigen::Vector3f& p, const BoneSegments& bones) {
  // Share of the squared radius; beyond it, pixels may be an arm's as well.
  constexpr float kWithin = 0.49F;
  const Eigen::Vector3f ray = p.normalized();
  const auto across = [&](const Eigen::Vector3f& q) -> Eigen::Vector3f {
    return q - ray.dot(q) * ray;
  };
  for (std::size_t k = 0; k < bones.count; ++k) {
    if (!is_spine_bone(bones.label[k])) continue;
    const Eigen::Vector3f from = across(bones.start[k]), bone = across(bones.end[k]) - from;
    const float t = std::clamp(-from.dot(bone) / squared_length(bone), 0.0F, 1.0F);
    const float radius = bones.radii[k].start + t * (bones.radii[k].end - bones.radii[k].start);
    if ((from + t * bone).squaredNorm() < kWithin * radius * radius) return true;
  }
  return false;
}

/// Share of the trunk that was removed together with an arm in front of it.
double lost_trunk(const PersonPoints& points, const BoneSegments& bones,
                  const PhantomImage& image) {
  std::int64_t all = 0, lost = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    if (image.kind[points.pixel[i]] != PixelKind::kNone) {
      all += is_spine_bone(points.label[i]);
    } else if (shows_trunk({points.x[i], points.y[i], points.z[i]}, bones)) {
      ++all;
      ++lost;
    }
  }
  return share_of(lost, all);
}

/// Share of the person below the hips that is empty. `Below` is measured both along the trunk,
/// which may lean, and along the image's columns; the larger share counts.
double lost_below(const PersonPoints& points, const Skeleton& person, const BodyFrame& frame,
                  const PhantomImage& image) {
  const Eigen::Vector3f origin = frame.origin.cast<float>(), up = frame.y.cast<float>();
  const float hips =
      is_usable(person, Joint::kSpineBase) ? person[Joint::kSpineBase].y() : origin.y();
  std::int64_t all = 0, lost = 0, all_upright = 0, lost_upright = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const bool is_lost = image.kind[points.pixel[i]] == PixelKind::kNone;
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const bool below = up.dot(p - origin) < 0.0F;
    const bool below_upright = p.y() > hips;
    all += below;
    lost += below && is_lost;
    all_upright += below_upright;
    lost_upright += below_upright && is_lost;
  }
  return std::max(share_of(lost, all), share_of(lost_upright, all_upright));
}

bool is_drawn_limb(PixelKind kind) {
  return (kind >= PixelKind::kPhantom) & (kind != PixelKind::kRootFilled);
}

/// Whether a joint belongs to the limb, its root included.
bool is_of_limb(Limb limb, Joint joint) {
  return is_limb_bone(limb, static_cast<std::size_t>(joint)) || joint == limb_root(limb);
}

/// Whether the person is seen so near to a joint that the joint may be displaced from there.
bool is_person_near(const Eigen::Vector3f& joint, const PersonPoints& points) {
  // Metres; a hand with all of its joints is smaller, the lower half of a leg is larger.
  constexpr float kNear = 0.3F;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    if ((p - joint).squaredNorm() < kNear * kNear) return true;
  }
  return false;
}

/// The thing that the depth image shows at a joint.
enum class JointSight : std::uint8_t {
  kOnPerson,    ///< The person.
  kHidden,      ///< Something much nearer to the camera; the person is seen near the joint.
  kHiddenAway,  ///< Something nearer to the camera; the person is not seen near the joint.
  kUnseen,      ///< No depth, as for black clothes; the person is not seen near the joint.
  kBeside       ///< None of these: joint and image do not match.
};

JointSight sight_of(const Eigen::Vector3f& joint, std::int32_t pixel, const DepthView& depth,
                    const PersonPoints& points, const PhantomImage& image) {
  // Pixels; joints of narrow parts such as wrists may lie just beside them.
  constexpr std::int32_t kMargin = 2;
  // With a wrong focal length, joints of feet project to nearer parts of the floor, by the same
  // factor as they are displaced; up to this factor, a joint with the person near to it counts as
  // displaced and not as hidden.
  constexpr float kMuchNearer = 0.85F;  // share of a joint's depth
  const auto cols = static_cast<std::int32_t>(image.cols);
  const auto rows = static_cast<std::int32_t>(image.rows);
  const std::int32_t u = pixel % cols, v = pixel / cols;
  bool is_measured = false;
  for (std::int32_t y = std::max(v - kMargin, 0); y <= std::min(v + kMargin, rows - 1); ++y) {
    for (std::int32_t x = std::max(u - kMargin, 0); x <= std::min(u + kMargin, cols - 1); ++x) {
      const std::int32_t near = y * cols + x;
      if (image.kind[near] == PixelKind::kBody) return JointSight::kOnPerson;
      is_measured |= depth.at(near) > 0.0F;
    }
  }
  const float z = depth.at(pixel);
  const bool is_nearer = z > 0.0F && z < joint.z();
  if (is_measured && !is_nearer) return JointSight::kBeside;
  if (!is_person_near(joint, points)) {
    return is_nearer ? JointSight::kHiddenAway : JointSight::kUnseen;
  }
  return is_nearer && z < kMuchNearer * joint.z() ? JointSight::kHidden : JointSight::kBeside;
}

}  // namespace

JointFit joint_fit(const Skeleton& person, Limb affected, const DepthView& depth,
                   const PixelProjector& projector, const PersonPoints& points,
                   const PhantomImage& image) {
  constexpr int kMinJoints = 5;
  int fits = 0, hidden = 0, hidden_below = 0, unseen = 0, all = 0;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const auto j = static_cast<Joint>(joint);
    if (is_of_limb(affected, j)) continue;
    if (person.state(j) != TrackingState::kTracked || !is_usable(person, j)) continue;
    const std::int32_t pixel = projector.pixel(person[j].x(), person[j].y(), person[j].z());
    if (pixel < 0) continue;  // trackers report joints beyond the image's border as well
    const JointSight sight = sight_of(person[j], pixel, depth, points, image);
    const bool is_below = is_of_limb(Limb::kLeftLeg, j) || is_of_limb(Limb::kRightLeg, j);
    const bool is_hidden_away = sight == JointSight::kHiddenAway;
    fits += sight == JointSight::kOnPerson;
    hidden += sight == JointSight::kHidden || is_hidden_away;
    // A table that hides the legs leaves an arm as it is.
    hidden_below += is_hidden_away && is_below && is_arm(affected);
    unseen += sight == JointSight::kUnseen;
    ++all;
  }
  if (all - unseen - hidden_below >= kMinJoints) {
    all -= unseen + hidden_below;
    hidden -= hidden_below;
  }
  if (all < kMinJoints) return {};
  return {static_cast<double>(fits) / all, static_cast<double>(hidden) / all};
}

double bone_fit(const PersonPoints& points, const Girth& girth) {
  constexpr float kNear = 0.20F;  // metres; at least 97 % of the points of real people are nearer
  const float reach = kNear + girth.around_trunk();
  std::int64_t near = 0;
  for (std::int64_t i = 0; i < points.count; ++i) {
    near += points.squared_distance[i] < reach * reach;
  }
  return points.count > 0 ? static_cast<double>(near) / static_cast<double>(points.count) : 1.0;
}

void PictureJudge::reserve(std::int64_t rows, std::int64_t cols) {
  cells_.resize(rows * cols);
  pieces_.reserve(rows, cols);
  sizes_.reserve(rows * ((cols + 1) / 2));
}

void PictureJudge::measure(const PersonPoints& points, std::int64_t num_given,
                           const Skeleton& phantom, const BoneSegments& bones, const Girth& girth,
                           const BodyFrame& frame, const PixelBox& box,
                           const PhantomOptions& options, const PixelRays& rays,
                           const PhantomImage& image, PhantomQuality& quality) {
  const Limb affected = options.affected;
  const Eigen::Vector3f root = phantom[limb_root(affected)];
  measure_pieces(root, box, rays, image, quality);
  quality.lost = is_arm(affected) ? lost_trunk(points, bones, image)
                                  : lost_below(points, phantom, frame, image);
  if (is_arm(affected)) {
    quality.stray = stray_share(points, affected, phantom, bones, girth, frame, image);
  }
  float farthest = 0.0F;
  for (const Joint joint : limb_chain(affected)) {
    if (is_usable(phantom, joint)) farthest = std::max(farthest, phantom[joint].z());
  }
  // The thicker a trunk is than the mean adult's, the less certain is the position of its flank.
  const float unsure = 0.5F * girth.around_trunk();
  std::int64_t limb = num_given, left = num_given;
  for (std::int64_t i = 0; i < points.count; ++i) {
    const Eigen::Vector3f p(points.x[i], points.y[i], points.z[i]);
    const std::int32_t pixel = points.pixel[i];
    if (points.label[i] != limb_label(affected) || !(p.z() < farthest + kBehind)) continue;
    ++limb;
    const bool is_left = image.kind[pixel] == PixelKind::kBody &&
                         image.label[pixel] == limb_label(affected) &&
                         (p - root).squaredNorm() > kAwayFromRoot * kAwayFromRoot;
    left += is_left && !(unsure > 0.0F && nearest_skin(p, bones, is_spine_bone).distance <
                                              points.skin_distance[i] + unsure);
  }
  if (!options.keep_residual) {
    quality.left = static_cast<double>(left) / std::max(kMinLimb, static_cast<double>(limb));
  }
}

void PictureJudge::measure_pieces(const Eigen::Vector3f& root, const PixelBox& box,
                                  const PixelRays& rays, const PhantomImage& image,
                                  PhantomQuality& quality) {
  for (std::int64_t row = 0; row < box.height; ++row) {
    const PixelKind* kinds = image.kind + (box.v0 + row) * image.cols + box.u0;
    std::uint8_t* cells = cells_.data() + row * box.width;
    for (std::int64_t i = 0; i < box.width; ++i) cells[i] = is_drawn_limb(kinds[i]) ? 1 : 0;
  }
  constexpr float kFarAway = 1e6F;  // square metres; farther than any pixel
  sizes_.clear();
  std::int64_t all = 0;
  for (const MarkedRun& run : pieces_.find(cells_.data(), box.height, box.width, false)) {
    const std::int64_t v = box.v0 + run.row;
    const std::size_t piece = run.component;
    // Components are numbered in the order of their first run.
    if (piece == sizes_.size()) sizes_.push_back({0, kFarAway});
    for (std::int64_t u = box.u0 + run.first; u <= box.u0 + run.last; ++u) {
      const float z = image.depth[v * image.cols + u];
      const float off = (lift(rays, u, v, z) - root).squaredNorm();
      sizes_[piece].nearest = std::min(sizes_[piece].nearest, off);
    }
    sizes_[piece].pixels += run.last - run.first + 1;
    all += run.last - run.first + 1;
  }
  const auto largest = std::ranges::max_element(sizes_, {}, &Piece::pixels);
  if (largest == sizes_.end()) return;
  quality.gap = std::sqrt(static_cast<double>(largest->nearest));
  quality.largest = static_cast<double>(largest->pixels) / static_cast<double>(all);
}

PhantomReason misfit(const PhantomQuality& quality, const Stature& stature,
                     const JointOffset& offset) {
  if (stature.misfit() > stature.limit() || offset.metres() > offset.limit() ||
      quality.fit + quality.hidden < kMinFit) {
    return PhantomReason::kCalibration;
  }
  return quality.fit < kMinFit ? PhantomReason::kOccluded : PhantomReason::kNone;
}

PhantomReason worst_of(Limb affected, const Girth& girth, const Stature& stature,
                       const JointOffset& offset, PhantomQuality& quality) {
  constexpr double kTrunkShare = 0.5;  // roots lie at the border of the trunk
  const double most_gap = (is_arm(affected) ? kMaxGapArm : kMaxGapLeg) +
                          kTrunkShare * static_cast<double>(girth.around_trunk());
  const double most_lost = is_arm(affected) ? kMaxLostTrunk : kMaxLostLegs;
  const std::array<std::pair<PhantomReason, double>, 13> measures = {{
      {PhantomReason::kCalibration, (1.0 - quality.fit) / (1.0 - kMinFit)},
      {PhantomReason::kCalibration, (stature.misfit() - 1.0) / (stature.limit() - 1.0)},
      {PhantomReason::kCalibration, offset.metres() / offset.limit()},
      {PhantomReason::kShaky, quality.plane_deg / kMaxPlane},
      {PhantomReason::kShaky, quality.across / kMaxAcross},
      {PhantomReason::kLeap, quality.leap / kMaxLeap},
      {PhantomReason::kDetached, quality.gap / most_gap},
      {PhantomReason::kShredded, (1.0 - quality.largest) / (1.0 - kMinLargest)},
      {PhantomReason::kCut, quality.lost / most_lost},
      {PhantomReason::kDoubled, quality.left / kMaxLeft},
      {PhantomReason::kCloth, quality.cloth / kMaxCloth},
      {PhantomReason::kInferred, quality.stray / kMaxStray},
      {PhantomReason::kOccluded, quality.outside / kMaxOutside},
  }};
  const auto worst =
      std::ranges::max_element(measures, {}, &decltype(measures)::value_type::second);
  quality.score = worst->second;
  const PhantomReason beside = misfit(quality, stature, offset);
  // A wrong calibration explains all other faults.
  if (beside != PhantomReason::kNone) return beside;
  // The rest of a phantom that is cut off by the image's border is detached or in pieces as well.
  if (quality.outside > kMaxOutside) return PhantomReason::kOccluded;
  return worst->second > 1.0 ? worst->first : PhantomReason::kNone;
}

}  // namespace manip3d
