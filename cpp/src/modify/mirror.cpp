#include "manip3d/modify/mirror.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

/// Orientation of a mirrored bone. The mirror image of a rotation R is (mirror) R diag(-1, 1, 1),
/// written with quaternions in the frame whose first axis is the plane's normal.
std::array<float, 4> mirror_orientation(const std::array<float, 4>& q, const BodyFrame& frame) {
  const Eigen::Quaternionf bone(q[0], q[1], q[2], q[3]);
  if (!bone.coeffs().allFinite() || bone.coeffs().isZero(0.0F)) return {};
  Eigen::Matrix3d axes;
  axes << frame.n, frame.y, frame.z;
  const Eigen::Quaterniond body(axes);
  const Eigen::Quaterniond in_body = body.conjugate() * bone.cast<double>();
  const Eigen::Quaterniond mirrored =
      body * Eigen::Quaterniond(in_body.w(), in_body.x(), -in_body.y(), -in_body.z());
  const Eigen::Quaternionf result = mirrored.cast<float>();
  return {result.w(), result.x(), result.y(), result.z()};
}

}  // namespace

std::optional<BodyFrame> body_frame(const Skeleton& skeleton, Limb limb) {
  using enum Joint;
  const bool arm = is_arm(limb);
  const Joint left = arm ? kShoulderLeft : kHipLeft, right = arm ? kShoulderRight : kHipRight;
  const Joint low = arm ? kSpineMid : kSpineBase, high = arm ? kSpineShoulder : kSpineMid;
  for (const Joint joint : {left, right, low, high}) {
    if (!is_usable(skeleton, joint)) return std::nullopt;
  }
  constexpr float kNearest = 0.1F;
  if (!(skeleton[low].z() > kNearest)) return std::nullopt;
  constexpr double kShortest = 0.05, kMinSine = 0.1;
  const Eigen::Vector3d across = (skeleton[left] - skeleton[right]).cast<double>();
  const Eigen::Vector3d up = (skeleton[high] - skeleton[low]).cast<double>();
  if (!(across.norm() > kShortest && up.norm() > kShortest)) return std::nullopt;
  BodyFrame frame;
  frame.origin = skeleton[low].cast<double>();
  frame.x = across.normalized();
  frame.y = up.normalized();
  frame.z = frame.x.cross(frame.y);
  if (!(frame.z.norm() > kMinSine)) return std::nullopt;
  frame.z.normalize();
  frame.n = frame.y.cross(frame.z);
  return frame;
}

Mirror make_mirror(const BodyFrame& frame, MirrorMode mode) {
  Mirror mirror;
  if (mode == MirrorMode::kImage) {
    // u' = 2 u_s - u at the same depth z: x' / z = 2 x_s / z_s - x / z.
    mirror.linear(0, 0) = -1.0;
    mirror.linear(0, 2) = 2.0 * frame.origin.x() / frame.origin.z();
    return mirror;
  }
  if (mode == MirrorMode::kPaper) {
    Eigen::Matrix3d m;
    m << frame.x.transpose(), frame.y.transpose(), frame.z.transpose();
    mirror.linear = m.inverse() * Eigen::Vector3d(-1.0, 1.0, 1.0).asDiagonal() * m;
  } else {
    mirror.linear -= 2.0 * frame.n * frame.n.transpose();
  }
  mirror.offset = frame.origin - mirror.linear * frame.origin;
  return mirror;
}

Skeleton with_mirrored_limb(const Skeleton& skeleton, Limb affected, const BodyFrame& frame,
                            const Mirror& mirror) {
  Skeleton result = skeleton;
  const auto root = static_cast<std::size_t>(limb_root(affected));
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    if (joint != root && !is_limb_bone(affected, joint)) continue;
    const std::size_t intact = kMirroredJoints[joint];
    result.states[joint] = skeleton.states[intact];
    const bool usable = is_usable(skeleton, static_cast<Joint>(intact));
    if (!usable) result.states[joint] = TrackingState::kNotTracked;
    result.positions[joint].setZero();
    if (usable) {
      result.positions[joint] = mirror(skeleton.positions[intact].cast<double>()).cast<float>();
    }
    result.orientations[joint] = mirror_orientation(skeleton.orientations[intact], frame);
  }
  return result;
}

}  // namespace manip3d
