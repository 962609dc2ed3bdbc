#include "manip3d/modify/placement.hpp"

#include <cmath>
#include <string>

#include "manip3d/error.hpp"
#include "modify/torso_frame.hpp"

namespace manip3d {

PlacementEstimator::PlacementEstimator(const PlacementOptions& options) : options_(options) {
  if (!(options.share > 0.0 && options.share <= 1.0)) {
    throw InputError("share: expected above 0 and up to 1, got " + number_text(options.share));
  }
  if (!(options.spread >= 0.0 && options.spread < 1.0)) {
    throw InputError("spread: expected 0 to below 1, got " + number_text(options.spread));
  }
  if (options.stable_frames < 1) {
    throw InputError("stable_frames: expected at least 1, got " +
                     std::to_string(options.stable_frames));
  }
  if (!(options.tolerance > 0.0)) {
    throw InputError("tolerance: expected above 0, got " + number_text(options.tolerance));
  }
}

void PlacementEstimator::reset() {
  placement_.reset();
  knee_height_ = 0.0;
  hip_centre_ = to_left_ = ahead_ = Eigen::Vector3d::Zero();
}

const std::optional<Placement>& PlacementEstimator::update(const Skeleton& skeleton,
                                                           bool left_is_intact) {
  using enum Joint;
  if (placement_ && placement_->frozen) return placement_;
  const Joint knee = left_is_intact ? kKneeLeft : kKneeRight;
  const Joint ankle = left_is_intact ? kAnkleLeft : kAnkleRight;
  const auto axes = torso_frame(skeleton);
  const bool tracked = skeleton.state(knee) == TrackingState::kTracked &&
                       skeleton.state(ankle) == TrackingState::kTracked &&
                       are_usable(skeleton, {knee, ankle});
  if (!axes || !tracked) return placement_;

  const double height = (skeleton[knee] - skeleton[ankle]).cast<double>().norm();
  const Eigen::Vector3d centre = skeleton[kSpineBase].cast<double>();
  if (placement_) {
    const double count = placement_->stable_frames;
    const bool stable = std::abs(height - knee_height_ / count) <= options_.tolerance &&
                        (centre - hip_centre_ / count).norm() <= options_.tolerance;
    if (!stable) reset();
  }
  if (!placement_) placement_.emplace();
  knee_height_ += height;
  hip_centre_ += centre;
  to_left_ += axes->col(0).cast<double>();
  ahead_ += axes->col(2).cast<double>();

  Placement& placement = *placement_;
  const double count = ++placement.stable_frames;
  placement.knee_height = knee_height_ / count;
  placement.reach = kReachPerKneeHeight * placement.knee_height;
  const double distance = options_.share * placement.reach;
  const Eigen::Vector3d left = to_left_.normalized();
  const Eigen::Vector3d ahead = (ahead_ - ahead_.dot(left) * left).normalized();
  const Eigen::Vector3d forward =
      hip_centre_ / count + distance * std::sqrt(1.0 - options_.spread * options_.spread) * ahead;
  placement.left = (forward + distance * options_.spread * left).cast<float>();
  placement.right = (forward - distance * options_.spread * left).cast<float>();
  placement.frozen = placement.stable_frames >= options_.stable_frames;
  return placement_;
}

}  // namespace manip3d
