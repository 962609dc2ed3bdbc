#include "modify/held_phantom.hpp"

#include <Eigen/Core>
#include <algorithm>

namespace manip3d {
namespace {

/// The rigid motion between the places of the body in two frames.
class BodyMotion {
 public:
  BodyMotion(const BodyFrame& from, const BodyFrame& to) {
    Eigen::Matrix3d a, b;
    a << from.n, from.y, from.z;
    b << to.n, to.y, to.z;
    const Eigen::Matrix3d rotation = b * a.transpose();
    rotation_ = rotation.cast<float>();
    translation_ = (to.origin - rotation * from.origin).cast<float>();
  }
  [[nodiscard]] Eigen::Vector3f operator()(const Eigen::Vector3f& p) const {
    return rotation_ * p + translation_;
  }
  void move(const std::vector<MirroredPoint>& from, std::vector<MirroredPoint>& to) const {
    to.assign(from.begin(), from.end());
    for (MirroredPoint& point : to) {
      const Eigen::Vector3f p = (*this)(Eigen::Vector3f(point.x, point.y, point.z));
      point.x = p.x(), point.y = p.y(), point.z = p.z();
    }
  }

 private:
  Eigen::Matrix3f rotation_;
  Eigen::Vector3f translation_;
};

}  // namespace

void HeldPhantom::reserve(std::size_t num_pixels) {
  points_.reserve(num_pixels);
  moved_.reserve(num_pixels);
}

void HeldPhantom::forget() {
  kept_.reset();
  time_s_ = -kInfinity;
}

void HeldPhantom::keep(const BodyFrame& frame, const Skeleton& skeleton, std::int64_t number,
                       double time_s) {
  kept_ = Kept{frame, skeleton, number, false};
  time_s_ = time_s;
}

HeldPhantom::Fate HeldPhantom::fate(const PhantomOptions& options, double time_s) const {
  const double age = time_s - time_s_;
  if (!kept_ || kept_->is_misplaced || !(age <= options.hold_seconds + options.fade_seconds)) {
    return {};
  }
  const double faded = age - options.hold_seconds;
  if (faded <= 0.0) return {PhantomState::kHolding, 1.0};
  return {PhantomState::kFading, 1.0 - faded / options.fade_seconds};
}

const MirroredLimb& HeldPhantom::moved_to(const BodyFrame& frame) {
  const BodyMotion motion(kept_->frame, frame);
  motion.move(points_.limb, moved_.limb);
  motion.move(points_.root, moved_.root);
  return moved_;
}

Skeleton HeldPhantom::skeleton(const Skeleton& person, Limb affected, const BodyFrame& frame,
                               bool is_mirrored_now) const {
  Skeleton result = person;
  const Skeleton& kept = kept_->skeleton;
  const BodyMotion motion(kept_->frame, frame);
  const auto take = [&](std::size_t joint) {
    result.states[joint] = kept.states[joint];
    result.positions[joint] = kept.positions[joint];
    result.orientations[joint] = kept.orientations[joint];
    if (is_mirrored_now || kept.states[joint] == TrackingState::kNotTracked) return;
    result.states[joint] = TrackingState::kInferred;
    result.positions[joint] = motion(kept.positions[joint]);
  };
  take(static_cast<std::size_t>(limb_root(affected)));
  for_each_phantom_joint(affected, take);
  return result;
}

Skeleton without_limb(const Skeleton& person, Limb affected) {
  Skeleton result = person;
  for_each_phantom_joint(affected, [&](std::size_t joint) {
    result.states[joint] = TrackingState::kNotTracked;
    result.positions[joint].setZero();
    result.orientations[joint] = {};
  });
  return result;
}

}  // namespace manip3d
