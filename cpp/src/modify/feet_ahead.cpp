#include "modify/feet_ahead.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <optional>
#include <utility>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

/// The directions of the body according to its joints; no value if a joint is missing.
struct UpAndAhead {
  Eigen::Vector3f up, ahead;
};

std::optional<UpAndAhead> directions(const Skeleton& person) {
  using enum Joint;
  if (!is_usable(person, kSpineBase) || !is_usable(person, kSpineShoulder)) return std::nullopt;
  Eigen::Vector3f left = Eigen::Vector3f::Zero();
  for (const auto& [from, to] :
       {std::pair{kShoulderRight, kShoulderLeft}, std::pair{kHipRight, kHipLeft}}) {
    if (!is_usable(person, from) || !is_usable(person, to)) return std::nullopt;
    left += (person[to] - person[from]).normalized();
  }
  const Eigen::Vector3f up = (person[kSpineShoulder] - person[kSpineBase]).normalized();
  return UpAndAhead{up, left.cross(up).normalized()};
}

}  // namespace

void FeetAhead::learn(const Skeleton& person, Limb affected) {
  // Cosine of 45 degrees; the feet of a kneeling person point backwards.
  constexpr float kStands = 0.7F;
  constexpr double kMemory = 20.0;  // frames
  const auto body = directions(person);
  if (!body || !is_usable(person, Joint::kHead)) return;
  float sum = 0.0F;
  int feet = 0;
  for (const Limb leg : {Limb::kLeftLeg, Limb::kRightLeg}) {
    if (leg == affected) continue;
    const auto lower = limb_chain(leg).subspan(1, 3);  // knee, ankle, foot
    const bool is_seen = std::ranges::all_of(lower, [&](Joint joint) {
      return person.state(joint) == TrackingState::kTracked && is_usable(person, joint);
    });
    if (!is_seen) continue;
    const Eigen::Vector3f shin = person[lower[0]] - person[lower[1]];
    if (!(body->up.dot(shin) > kStands * shin.norm())) continue;
    sum += body->ahead.dot(person[lower[2]] - person[lower[1]]);
    ++feet;
  }
  if (feet == 0) return;
  frames_ = std::min(frames_ + 1.0, kMemory);
  feet_m_ += (static_cast<double>(sum) / feet - feet_m_) / frames_;
  const float head = body->ahead.dot(person[Joint::kHead] - person[Joint::kSpineShoulder]);
  head_m_ += (static_cast<double>(head) - head_m_) / frames_;
}

}  // namespace manip3d
