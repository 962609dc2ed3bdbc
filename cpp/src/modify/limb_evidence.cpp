#include "modify/limb_evidence.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

// Lengths in metres.
constexpr float kBeside = 0.08F;   // flesh may be so far beside a joint: trackers err and lag
constexpr float kWithin = 0.12F;   // and so far before or behind it
constexpr float kLonger = 1.5F;    // times as long as the other limb's bone,
constexpr float kAllowed = 0.05F;  // and the errors of two joints

/// Does the camera look through the place of a joint? Beyond the image's border nothing is known.
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

bool is_too_long(const Skeleton& person, Limb limb, std::size_t bone) {
  const auto chain = limb_chain(limb), other = limb_chain(opposite(limb));
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

}  // namespace manip3d
