#include "modify/patient.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "geometry/constants.hpp"

namespace manip3d {
namespace {

/// Whether all usable pairs of shoulders and hips point against the body's left. If one of the
/// pairs is tracked, a pair with an inferred joint, as a seated hip often is, is ignored.
bool has_sides_swapped(const Skeleton& reported, const BodyFrame& frame) {
  using enum Joint;
  constexpr std::array kPairs = {std::pair{kShoulderLeft, kShoulderRight},
                                 std::pair{kHipLeft, kHipRight}};
  // Cosine; well beyond 90 degrees, which a turning body passes slowly.
  constexpr double kAgainst = -0.5;
  const auto is_tracked = [&](const auto& pair) {
    return reported.state(pair.first) == TrackingState::kTracked &&
           reported.state(pair.second) == TrackingState::kTracked;
  };
  const bool any_tracked = std::ranges::any_of(kPairs, is_tracked);
  bool is_known = false;
  for (const auto& pair : kPairs) {
    const auto& [left, right] = pair;
    if (!is_usable(reported, left) || !is_usable(reported, right)) continue;
    if (any_tracked && !is_tracked(pair)) continue;
    const Eigen::Vector3d across = (reported[left] - reported[right]).cast<double>();
    if (!(frame.n.dot(across) < kAgainst * across.norm())) return false;
    is_known = true;
  }
  return is_known;
}

Skeleton with_sides_swapped(const Skeleton& reported) {
  Skeleton result = reported;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const std::size_t other = kMirroredJoints[joint];
    result.positions[joint] = reported.positions[other];
    result.orientations[joint] = reported.orientations[other];
    result.states[joint] = reported.states[other];
  }
  return result;
}

}  // namespace

Patient::Patient(const PhantomOptions& options)
    : affected_(options.affected),
      smooths_(options.smooths),
      most_lost_(options.hold_seconds + options.fade_seconds),
      key_person_(options.key_person),
      smoother_(options.smoothing),
      sides_kept_since_(-kInfinity),
      sides_known_since_(-kInfinity) {}

PatientFrame Patient::find(const PhantomInput& input, const PixelRays& rays, const BodyFrame* frame,
                           double time_s) {
  PatientFrame now;
  look_at_clothes(input, rays);
  const auto index = key_person_.find(input.people, input.camera, time_s, clothes_);
  if (!index) {
    now.is_new = key_person_.lost_for(time_s) >= most_lost_;
    if (now.is_new) start(std::nullopt);
    now.person = person_;
    return now;
  }
  now.is_here = has_been_seen_ = true;
  now.raw = input.people[*index];
  if (id_ != now.raw.id && !is_at_same_place(now.raw)) {
    start(now.raw.id);
    now.is_new = true;
  }
  id_ = now.raw.id;
  if (keep_sides(now.raw, now.is_new ? nullptr : frame, time_s)) now.is_new = true;
  person_ = smoothed(now.raw);
  now.person = person_;
  return now;
}

void Patient::reset() {
  key_person_.reset();
  has_been_seen_ = false;
  start(std::nullopt);
}

void Patient::start(std::optional<std::int64_t> id) {
  id_ = id;
  person_.reset();
  smoother_.reset();
  feet_.reset();
}

void Patient::look_at_clothes(const PhantomInput& input, const PixelRays& rays) {
  clothes_.clear();
  if (input.color.pixels == nullptr) return;
  const ColoredScene scene{input.depth, input.body_index,   &input.camera,
                           &rays,       input.registration, input.color};
  for (const Skeleton& person : input.people) clothes_.push_back(clothing_colors(person, scene));
}

/// A tracker may exchange left and right for a moment, which does not move a limb to the other
/// side. In that case they are exchanged back in `reported`. If the tracker keeps to the exchanged
/// sides for longer than patience_for_sides(), they are accepted and the person starts again.
/// Returns whether that happened.
bool Patient::keep_sides(Skeleton& reported, const BodyFrame* frame, double time_s) {
  if (frame == nullptr) sides_known_since_ = time_s;
  if (frame == nullptr || !has_sides_swapped(reported, *frame)) {
    sides_kept_since_ = time_s;
    feet_.learn(reported, affected_);
    return false;
  }
  if (time_s - sides_kept_since_ <= patience_for_sides()) {
    reported = with_sides_swapped(reported);
    feet_.learn(reported, affected_);
    return false;
  }
  start(reported.id);
  sides_kept_since_ = sides_known_since_ = time_s;
  feet_.learn(reported, affected_);
  return true;
}

/// Seconds for which a tracker that exchanged left and right is not believed: infinite if the feet
/// show that the previous sides are correct, 0 if the feet show that they are wrong; otherwise the
/// longer, the longer the previous sides were kept.
double Patient::patience_for_sides() const {
  constexpr double kLeast = 0.5, kMost = 2.0;
  if (feet_.point_ahead()) return kInfinity;
  if (feet_.point_backwards()) return 0.0;
  return std::clamp(0.5 * (sides_kept_since_ - sides_known_since_), kLeast, kMost);
}

/// Whether the skeleton is at the last place of the patient; trackers may give the same person
/// another id.
bool Patient::is_at_same_place(const Skeleton& reported) const {
  constexpr float kSamePlace = 0.3F;  // metres
  const auto before = person_ ? spine_base(*person_) : std::nullopt, now = spine_base(reported);
  return before && now && (*before - *now).norm() < kSamePlace;
}

/// Without smoothing, positions are those of `reported`, and only the states come from the
/// smoother.
Skeleton Patient::smoothed(const Skeleton& reported) {
  Skeleton result = smoother_.add(reported);
  if (smooths_) return result;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (result.states[joint] != TrackingState::kNotTracked) {
      result.positions[joint] = reported.positions[joint];
    }
  }
  return result;
}

bool is_in_another_unit(const Skeleton& skeleton) {
  constexpr float kFarthestJoint = 100.0F;  // metres
  bool is_far = false;
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (skeleton.states[joint] != TrackingState::kTracked) continue;
    const Eigen::Vector3f& p = skeleton.positions[joint];
    if (!(p.cwiseAbs().maxCoeff() > kFarthestJoint && p.allFinite())) return false;
    is_far = true;
  }
  return is_far;
}

}  // namespace manip3d
