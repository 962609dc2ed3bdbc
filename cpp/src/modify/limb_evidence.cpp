#include "modify/limb_evidence.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <span>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

// Points within kBeside of a joint across the viewing direction, because trackers err and lag, and
// within kWithin along it belong to the joint; metres.
constexpr float kBeside = 0.08F;
constexpr float kWithin = 0.12F;
// A bone is too long if it is longer than kLonger times that of the other limb, plus kAllowed
// metres for the errors of two joints.
constexpr float kLonger = 1.5F;
constexpr float kAllowed = 0.05F;

/// Whether the camera looks through the place of a joint. False beyond the image's border, because
/// nothing is known there.
bool is_seen_through(const Eigen::Vector3f& p, std::uint8_t body, const DepthView& depth,
                     const std::uint8_t* body_index, const PixelProjector& projector) {
  const std::int32_t low = projector.pixel(p.x() - kBeside, p.y() - kBeside, p.z());
  const std::int32_t high = projector.pixel(p.x() + kBeside, p.y() + kBeside, p.z());
  if (low < 0 || high < 0) return false;
  const auto cols = static_cast<std::int32_t>(depth.cols);
  const auto [u0, u1] = std::minmax({low % cols, high % cols});  // images may be mirrored
  const auto [v0, v1] = std::minmax({low / cols, high / cols});
  for (std::int32_t v = v0; v <= v1; ++v) {
    for (std::int32_t u = u0; u <= u1; ++u) {
      const std::int64_t pixel = std::int64_t{v} * cols + u;
      const float z = depth.at(pixel);
      if (!(z > 0.0F && z < p.z() + kWithin)) continue;
      const bool is_hidden = z < p.z() - kWithin;
      if (is_hidden || body_index == nullptr || body_index[pixel] == body) return false;
    }
  }
  return true;
}

/// Whether a bone is much longer than that of the other limb. False unless the end of the other
/// bone is tracked: if the other limb is the one that is missing, its joints are guessed at the
/// stump.
bool is_too_long(const Skeleton& person, Limb limb, std::size_t bone) {
  const auto chain = limb_chain(limb), other = limb_chain(opposite(limb));
  if (person.state(other[bone]) != TrackingState::kTracked) return false;
  for (const Joint joint : {chain[bone - 1], chain[bone], other[bone - 1], other[bone]}) {
    if (!is_usable(person, joint)) return false;
  }
  const float mine = (person[chain[bone]] - person[chain[bone - 1]]).norm();
  const float intact = (person[other[bone]] - person[other[bone - 1]]).norm();
  return mine > kLonger * intact + kAllowed;
}

}  // namespace

bool may_have_limb(const Skeleton& person, Limb limb, const DepthView& depth,
                   const std::uint8_t* body_index, const PixelProjector& projector) {
  const auto chain = limb_chain(limb);
  for (std::size_t k = 1; k < kNumMainJoints; ++k) {
    if (person.state(chain[k]) != TrackingState::kTracked || !is_usable(person, chain[k])) continue;
    if (is_too_long(person, limb, k)) return false;
    if (is_seen_through(person[chain[k]], person.body, depth, body_index, projector)) return false;
  }
  return true;
}

float limb_length(const Skeleton& skeleton, Limb limb) {
  float length = 0.0F;
  Joint last = limb_root(limb);
  for (const Joint joint : limb_chain(limb)) {
    if (!is_usable(skeleton, joint) || !is_usable(skeleton, last)) continue;
    length += (skeleton[joint] - skeleton[last]).norm();
    last = joint;
  }
  return length;
}

double visible_share(const Skeleton& skeleton, Limb limb, const PixelProjector& projector,
                     const PhantomImage& image) {
  constexpr int kSamples = 16;  // per bone; about every two centimetres
  double seen = 0.0, all = 0.0;
  for (std::size_t i = 1; i < kNumMainJoints; ++i) {
    const Joint from = limb_chain(limb)[i - 1], to = limb_chain(limb)[i];
    if (!is_usable(skeleton, from) || !is_usable(skeleton, to)) continue;
    const Eigen::Vector3f step = (skeleton[to] - skeleton[from]) / kSamples;
    const auto length = static_cast<double>(step.norm());
    for (int k = 0; k < kSamples; ++k) {
      const Eigen::Vector3f p = skeleton[from] + (static_cast<float>(k) + 0.5F) * step;
      const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
      all += length;
      if (pixel < 0 || !is_limb_bone(limb, image.label[pixel])) continue;
      if (image.depth[pixel] < p.z() + kWithin) seen += length;
    }
  }
  return all > 0.0 ? seen / all : 0.0;
}

bool shows_limb_at(const Skeleton& skeleton, Limb limb, Joint joint,
                   const PixelProjector& projector, const PhantomImage& image) {
  constexpr float kWithinLimb = 0.12F;  // metres from a joint to the skin in front of it
  if (!is_usable(skeleton, joint)) return false;
  const Eigen::Vector3f& p = skeleton[joint];
  const std::int32_t pixel = projector.pixel(p.x(), p.y(), p.z());
  if (pixel < 0 || std::abs(image.depth[pixel] - p.z()) > kWithinLimb) return false;
  return is_limb_bone(limb, image.label[pixel]);
}

bool is_guessed_at_stump(const Skeleton& skeleton, Limb limb) {
  constexpr float kShort = 0.4F;  // share of the other limb's length
  const auto is_tracked = [&](Joint joint) {
    return skeleton.state(joint) == TrackingState::kTracked;
  };
  const auto mine = limb_chain(limb).first(kNumMainJoints).subspan(1);
  const auto other = limb_chain(opposite(limb)).first(kNumMainJoints).subspan(1);
  if (std::ranges::all_of(mine, is_tracked) || !std::ranges::all_of(other, is_tracked)) {
    return false;
  }
  float reach = 0.0F;
  for (const Joint joint : mine) {
    if (!is_usable(skeleton, joint) || !is_usable(skeleton, limb_root(limb))) continue;
    reach = std::max(reach, (skeleton[joint] - skeleton[limb_root(limb)]).norm());
  }
  return reach < kShort * limb_length(skeleton, opposite(limb));
}

bool has_main_joints(const Skeleton& skeleton, Limb affected) {
  constexpr std::size_t kInner = kNumMainJoints - 1;
  bool all = is_usable(skeleton, Joint::kHead) && is_usable(skeleton, Joint::kSpineBase) &&
             is_usable(skeleton, Joint::kSpineMid) && is_usable(skeleton, Joint::kSpineShoulder);
  for (const Limb limb : {Limb::kLeftArm, Limb::kRightArm, Limb::kLeftLeg, Limb::kRightLeg}) {
    if (limb == affected) continue;
    for (const Joint joint : limb_chain(limb).first(kInner)) {
      all = all && is_usable(skeleton, joint);
    }
  }
  return all;
}

void LimbPresence::add(const Skeleton& skeleton, Limb affected, const PixelProjector& projector,
                       const PhantomImage& image) {
  constexpr double kMinVisible = 0.5;  // share of a limb's length
  constexpr double kFrames = 20.0;     // frames in the mean
  // The two arms, or legs, of a person differ by a smaller share.
  constexpr float kOtherLength = 0.3F;
  const auto visible = [&](Limb limb) { return visible_share(skeleton, limb, projector, image); };
  // If the joints of the intact limb are beside the person, those of the affected limb may lie on
  // it by chance.
  if (!(visible(opposite(affected)) >= kMinVisible)) return;
  const float length = limb_length(skeleton, affected);
  const float intact = limb_length(skeleton, opposite(affected));
  // The root is left out, because it is inferred whenever a seated person's thigh hides it.
  const auto chain = limb_chain(affected).first(kNumMainJoints).subspan(1);
  const bool is_tracked = std::ranges::all_of(
      chain, [&](Joint j) { return skeleton.state(j) == TrackingState::kTracked; });
  const bool is_seen = is_tracked && std::abs(length - intact) < kOtherLength * intact &&
                       visible(affected) >= kMinVisible;
  frames_ = std::min(frames_ + 1.0, kFrames);
  // At first, a frame that shows the limb has more weight than one that does not, because joints
  // may be wrong.
  share_ += is_seen ? (1.0 - share_) / frames_ : -share_ / kFrames;
}

}  // namespace manip3d
