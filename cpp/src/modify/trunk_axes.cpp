#include "modify/trunk_axes.hpp"

#include <algorithm>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

using enum Joint;

struct Line {
  Eigen::Vector3d point = Eigen::Vector3d::Zero(), direction = Eigen::Vector3d::Zero();
};

/// The least-squares line through the joints of the spine, in upward direction.
std::optional<Line> middle_line(const Skeleton& skeleton, const JointTrust& trust) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weight = 0.0;
  int count = 0;
  for (const Joint joint : kSpineJoints) {
    if (!is_usable(skeleton, joint)) continue;
    sum += trust_of(trust, joint) * skeleton[joint].cast<double>();
    weight += trust_of(trust, joint);
    ++count;
  }
  if (count < 2) return std::nullopt;
  Line line;
  line.point = sum / weight;
  // Joints are weighted by their heights along the spine relative to the mean, as in linear
  // regression.
  constexpr std::array kHeights = {0.0, 0.31, 0.535,
                                   0.61};  // heights of kSpineJoints above SpineBase, metres
  double mean = 0.0;
  for (std::size_t i = 0; i < kSpineJoints.size(); ++i) {
    if (!is_usable(skeleton, kSpineJoints[i])) continue;
    mean += kHeights[i] * trust_of(trust, kSpineJoints[i]) / weight;
  }
  for (std::size_t i = 0; i < kSpineJoints.size(); ++i) {
    if (!is_usable(skeleton, kSpineJoints[i])) continue;
    line.direction += trust_of(trust, kSpineJoints[i]) * (kHeights[i] - mean) *
                      (skeleton[kSpineJoints[i]].cast<double>() - line.point);
  }
  constexpr double kShortest = 1e-3;  // square metres
  if (!(count * line.direction.norm() > kShortest * weight)) return std::nullopt;
  line.direction.normalize();
  return line;
}

struct JointPair {
  Eigen::Vector3d across;  ///< From right to left.
  double trust = 0.0;      ///< Trust of the less trusted of the two joints.
};

/// If one of the joints is missing, the distance between the other one and the middle is doubled.
std::optional<JointPair> pair_of(const Skeleton& skeleton, const JointTrust& trust, Joint left,
                                 Joint right, Joint middle) {
  const bool has_left = is_usable(skeleton, left), has_right = is_usable(skeleton, right);
  const auto between = [&](Joint from, Joint to, double times) {
    return JointPair{times * (skeleton[to] - skeleton[from]).cast<double>(),
                     std::min(trust_of(trust, from), trust_of(trust, to))};
  };
  if (has_left && has_right) return between(right, left, 1.0);
  if (!(has_left || has_right) || !is_usable(skeleton, middle)) return std::nullopt;
  return has_left ? between(middle, left, 2.0) : between(right, middle, 2.0);
}

/// Removes most of the sideways tilt from a plane for legs: on a seat and over two feet a pelvis
/// stays level even if the spine leans. Larger tilts are kept, because a sensor may lie on its
/// side.
void level(BodyFrame& frame, const Eigen::Vector3d& down) {
  // Share of the tilt that is removed; sine above which a tilt is kept.
  constexpr double kShare = 1.0 - kLeftTilt, kBelieved = 0.25;
  const double tilt = frame.n.dot(down);
  const double share = kShare / (1.0 + (tilt * tilt) / (kBelieved * kBelieved));
  frame.n = (frame.n - share * tilt * down).normalized();
  frame.x = frame.n;
  frame.y = (frame.y - frame.y.dot(frame.n) * frame.n).normalized();
  frame.z = frame.n.cross(frame.y);
}

}  // namespace

std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb, const JointTrust& trust,
                                     const Eigen::Vector3d& down) {
  const auto line = middle_line(skeleton, trust);
  if (!line) return std::nullopt;
  const bool arm = is_arm(limb);
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  double weight = 0.0;
  const auto add = [&](const std::optional<JointPair>& pair, double share) {
    if (!pair) return;
    x += share * pair->trust * pair->across;
    weight += pair->trust;
  };
  add(pair_of(skeleton, trust, kShoulderLeft, kShoulderRight, kSpineShoulder),
      arm ? 1.0 : kOtherPair);
  add(pair_of(skeleton, trust, kHipLeft, kHipRight, kSpineBase), arm ? kOtherPair : 1.0);
  // Metres from right to left; sine of the angle between x and the spine; metres in front of the
  // camera.
  constexpr double kShortest = 0.05, kMinSine = 0.1, kNearest = 0.1;
  if (!(x.norm() > kShortest * std::min(weight, 1.0))) return std::nullopt;
  BodyFrame frame;
  frame.x = x.normalized();
  frame.y = line->direction;
  frame.z = frame.x.cross(frame.y);
  if (!(frame.z.norm() > kMinSine)) return std::nullopt;
  frame.z.normalize();
  frame.n = frame.y.cross(frame.z);
  const Joint height = arm ? kSpineMid : kSpineBase;
  if (!arm) level(frame, down);
  frame.origin = line->point;
  if (is_usable(skeleton, height)) {
    const Eigen::Vector3d joint = skeleton[height].cast<double>();
    frame.origin = joint - frame.n.dot(joint - line->point) * frame.n;
  }
  if (!(frame.origin.z() > kNearest)) return std::nullopt;
  return frame;
}

std::optional<BodyFrame> trunk_frame(const Skeleton& skeleton, Limb limb,
                                     const Eigen::Vector3d& down) {
  JointTrust all;
  all.fill(1.0);
  return trunk_frame(skeleton, limb, all, down);
}

}  // namespace manip3d
