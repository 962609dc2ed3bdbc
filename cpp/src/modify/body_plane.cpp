#include "modify/body_plane.hpp"

#include <algorithm>

namespace manip3d {

void BodyPlane::learn_vertical(const Skeleton& person, const PhantomInput& input,
                               const PixelRays& rays, double time_s) {
  if (!is_usable(person, Joint::kSpineBase)) return;
  vertical_.learn(input.depth, input.body_index, rays, person[Joint::kSpineBase]);
  const bool sees_floor = vertical_.is_known();
  if (!sees_floor) upright_.learn(person, options_.affected, time_s);
  if (!is_of_leg()) return;
  if (sees_floor) {
    trunk_.set_down(vertical_.down());
  } else {
    trunk_.set_down(upright_.down(), upright_.covariance());
  }
}

DownSource BodyPlane::down_source() const {
  if (vertical_.is_known()) return DownSource::kFloor;
  return upright_.is_known() ? DownSource::kPosture : DownSource::kAssumed;
}

std::optional<FloorPlane> BodyPlane::floor_under(const Skeleton& person) const {
  constexpr float kFootIsOff = 0.12F;  // metres
  using enum Joint;
  const auto& floor = vertical_.floor();
  if (!floor) return std::nullopt;
  for (const Joint joint : {kAnkleLeft, kAnkleRight, kFootLeft, kFootRight}) {
    if (person.state(joint) != TrackingState::kTracked || !is_usable(person, joint)) continue;
    if (floor->normal.dot(person[joint]) > floor->height + kFootIsOff) return std::nullopt;
  }
  return floor;
}

void BodyPlane::update(const Skeleton* raw, const Skeleton& fitted, const JointOffset& offset,
                       const PhantomInput& input, const PixelRays& rays, double time_s) {
  trunk_.set_offset(offset.shared());
  const auto frame = follows_trunk() ? trunk_.update(raw, input.depth, rays, input.camera, time_s)
                                     : body_frame(fitted, options_.affected);
  if (frame) {
    set_frame(*frame);
  } else if (trunk_frame_) {
    const Joint origin = is_of_leg() ? Joint::kSpineBase : Joint::kSpineMid;
    const bool seen = is_usable(fitted, origin) && fitted[origin].z() > 0.1F;
    if (seen) trunk_frame_->origin = fitted[origin].cast<double>();
    set_frame(*trunk_frame_);
  }
}

void BodyPlane::learn_surface(const PersonPoints& points, const PhantomInput& input,
                              const PixelRays& rays) {
  if (!follows_trunk()) return;
  trunk_.learn(points, input.depth, rays, input.camera);
  if (const auto learnt = trunk_.frame()) set_frame(*learnt);
}

void BodyPlane::follow_legs(const PersonPoints& points, const Skeleton& fitted, bool has_limb) {
  if (!follows_trunk() || !goes_by_skin() || !is_of_leg() || !trunk_frame_) return;
  if (has_limb) {
    legs_.learn(points, fitted, *trunk_frame_);
  } else {
    legs_.lose_trust();
  }
  set_frame(*trunk_frame_);
}

double BodyPlane::deviation_across(const Skeleton& person) const {
  constexpr double kSure = 2.0;  // standard deviations within which a joint may be on either side
  const Limb intact = opposite(options_.affected);
  const double left = limb_root(intact) == Joint::kHipLeft ? 1.0 : -1.0;
  double worst = 0.0;
  for (const Joint joint : limb_chain(intact).subspan(1)) {
    if (!is_usable(person, joint)) continue;
    const Eigen::Vector3d p = person[joint].cast<double>();
    const double deviation = trunk_.deviation_at(p, *frame_);
    const double distance = left * frame_->n.dot(p - frame_->origin);
    if (distance < kSure * deviation) worst = std::max(worst, deviation);
  }
  return worst;
}

bool BodyPlane::tells_legs_apart() const {
  constexpr double kMaxDeg = 10.0;  // then a knee is off by half of its width
  const bool is_asked = is_of_leg() && goes_by_skin() && follows_trunk();
  return is_asked && frame_ && trunk_.deviation_deg() < kMaxDeg;
}

void BodyPlane::forget_person() {
  trunk_.reset();
  legs_.reset();
  trunk_frame_.reset();
  frame_.reset();
}

void BodyPlane::forget_down() {
  vertical_.reset();
  upright_.reset();
}

void BodyPlane::set_frame(const BodyFrame& trunk) {
  trunk_frame_ = trunk;
  frame_ = legs_.of(trunk);
  mirror_ = make_mirror(*frame_, options_.mode);
}

}  // namespace manip3d
