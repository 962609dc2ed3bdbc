#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/progress.hpp"

/// @file
/// Virtual enhancement (dissertation, introduction to part II): the user's avatar moves farther
/// than the user does.
namespace manip3d {

struct ReposeOptions {
  /// By joint: factor on the angle between the rest pose and the current pose; default: 1.
  std::array<double, kNumJoints> gain{};
  /// By joint: largest angle from the rest pose after the factor, radians; default: pi.
  std::array<double, kNumJoints> limit{};
  bool blended = true;  ///< False: each vertex moves rigidly with its nearest bone.
  /// Bones whose distance exceeds that of the nearest bone by this have no weight; metres.
  double band = 0.08;
  int num_threads = 0;

  ReposeOptions();
};

/// Whether a joint can have a gain or a limit: shoulders, elbows, wrists, hips, knees, ankles,
/// neck.
bool is_posable(std::size_t joint);

/// Rigid motion of each bone: x -> rotation x + translation.
struct BoneMotions {
  std::array<Eigen::Quaterniond, kNumJoints> rotation;
  std::array<Eigen::Vector3d, kNumJoints> translation;
  std::array<bool, kNumJoints> moves{};  ///< False: exactly the identity.

  BoneMotions();
  [[nodiscard]] Eigen::Vector3d apply(std::size_t bone, const Eigen::Vector3d& x) const {
    return moves[bone] ? Eigen::Vector3d(rotation[bone] * x + translation[bone]) : x;
  }
};

/// Turn each joint away from its rest pose by gain times its angle, within its limit.
///
/// The rest pose is a skeleton or, without one, a standing person: arms and legs hang along the
/// spine, feet point ahead, the head is up. Its torso is rotated onto the current torso. From there
/// outwards each bone is compared with the direction that it would have if its joint were at rest
/// and the bones before it were as they are. The shortest rotation between the two directions is
/// the rotation of the joint; twist about a bone is kept. Everything beyond a bone moves with it. A
/// bone that points opposite to its rest direction has no shortest rotation and is not changed.
/// @throws InputError  a gain not in [0, 100], a limit that is not >= 0, one of a joint that is not
///                     posable.
/// @return  No value if the torso of one of the two skeletons is not tracked.
std::optional<BoneMotions> amplify(const Skeleton& now, const Skeleton* rest,
                                   const ReposeOptions& options);

/// Return the skeleton after the motions; bones keep their lengths.
Skeleton move_skeleton(const Skeleton& now, const BoneMotions& motions);

/// Moves vertices (count, 3) of the person in pose `now`: each rigidly with its nearest bone, or,
/// if `blended`, by blended dual quaternions [Kavan et al., "Geometric skinning with approximate
/// dual quaternion blending", 2008]. A bone's weight is h(d - d_min) g(l). d is the distance of the
/// vertex from the bone, and d_min that from the nearest bone; h falls from 1 to 0 over `band`. l
/// is the distance along the skeleton between the nearest points on the bone and on the nearest
/// bone; g falls from 1 at 0.15 m to 0 at 0.3 m, so that a hand at the hip does not pull the hip.
/// Vertices on which no moving bone has a weight are copied bit for bit. The result is the same for
/// any number of threads.
/// @throws InputError  band not > 0.
template <typename Scalar>
void repose_vertices(const Scalar* vertices, std::int64_t count, const Skeleton& now,
                     const BoneMotions& motions, const ReposeOptions& options, Scalar* out,
                     const Progress& progress = {});

}  // namespace manip3d
