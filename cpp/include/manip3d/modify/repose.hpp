#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Virtual enhancement (dissertation introduction to part II): the user's own avatar moves further
/// than the user does.
namespace manip3d {

struct ReposeOptions {
  /// By joint: what the angle between rest and now is multiplied by; 1.
  std::array<double, kNumJoints> gain{};
  /// By joint: the largest angle from rest afterwards, radians; pi.
  std::array<double, kNumJoints> limit{};
  bool blended = true;  ///< False: each vertex moves with its nearest bone alone.
  double band = 0.08;  ///< Bones that are farther than the nearest by so much do not count; metres.
  int num_threads = 0;

  ReposeOptions();
};

/// May a joint have a gain or a limit? Shoulders, elbows, wrists, hips, knees, ankles, the neck.
bool is_posable(std::size_t joint);

/// How the bones move: x -> rotation x + translation.
struct BoneMotions {
  std::array<Eigen::Quaterniond, kNumJoints> rotation;
  std::array<Eigen::Vector3d, kNumJoints> translation;
  std::array<bool, kNumJoints> moves{};  ///< False: exactly the identity.

  BoneMotions();
  [[nodiscard]] Eigen::Vector3d apply(std::size_t bone, const Eigen::Vector3d& x) const {
    return moves[bone] ? Eigen::Vector3d(rotation[bone] * x + translation[bone]) : x;
  }
};

/// Each joint turns away from rest by gain times the angle, within its limit.
///
/// Rest is a skeleton or, without one, a person who stands: arms and legs hang along the spine,
/// feet point ahead, the head is up. Its torso is turned onto the torso of now; from there outwards
/// each bone is compared with where it would be had its joint stayed at rest, bones before it being
/// where they are now. The shortest turn between the two is the joint's; twist about a bone stays.
/// What hangs from a bone moves with it. A bone opposite to its rest has no shortest turn and is
/// left.
/// @throws InputError  a gain not in [0, 100], a limit that is not >= 0, one of a joint that is not
///                     posable.
/// @return  none: the torso of one of the two is not tracked.
std::optional<BoneMotions> amplify(const Skeleton& now, const Skeleton* rest,
                                   const ReposeOptions& options);

/// The skeleton after the motions: bones keep their lengths.
Skeleton move_skeleton(const Skeleton& now, const BoneMotions& motions);

/// Moves vertices (count, 3) of the person in pose `now` along: each with its nearest bone, or with
/// dual quaternions blended [Kavan et al., "Geometric skinning with approximate dual quaternion
/// blending", 2008]. A bone's weight is h(d - d_min) g(l): h falls from 1 to 0 over the band, l is
/// the way along the skeleton between the nearest points on it and on the nearest bone, and g falls
/// from 1 at 0.15 m to 0 at 0.3 m, so that a hand at the hip does not pull at the hip. Vertices of
/// bones that do not move keep their bits. The same result for any number of threads.
/// @throws InputError  band not > 0.
template <typename Scalar>
void repose_vertices(const Scalar* vertices, std::int64_t count, const Skeleton& now,
                     const BoneMotions& motions, const ReposeOptions& options, Scalar* out,
                     const Progress& progress = {});

}  // namespace manip3d
