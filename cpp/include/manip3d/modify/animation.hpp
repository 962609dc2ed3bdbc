#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/skeleton.hpp"
#include "manip3d/modify/repose.hpp"

/// @file
/// A person's depth mesh that follows another skeleton (dissertation section 5.1.2).
namespace manip3d {

struct AnimationMeshOptions {
  DepthStepOptions step;
  /// Only pixels of bones that meet at a joint share a triangle. Without it limbs drag along what
  /// they lie on (figure 5.5).
  bool by_label = true;
  /// Metres around the joint between them within which bones one apart may share a triangle too:
  /// upper arm and chest at the shoulder. 0: never, as published.
  double joint_reach = 0.15;
};

/// The labelled pixels of a person, with triangles that can be taken apart at joints.
struct AnimationMesh {
  Rows<float, 3> vertices;           ///< (n, 3) metres, row by row of the image.
  Rows<std::int32_t, 2> pixels;      ///< (n, 2) column and row.
  std::vector<std::uint8_t> labels;  ///< (n,) bone, 1 to 24.
  Rows<std::int32_t, 3> faces;       ///< (m, 3); front faces look at the camera.
};

/// Cells of 2x2 pixels as grid_mesh() cuts them; a triangle counts if its depths are connected
/// (DepthStep) and its bones fit together.
/// @param labels    (rows, cols) bone of each pixel, 0: not the person.
/// @param skeleton  Null: there are no joints, bones must meet.
/// @throws InputError  sizes differ, a label above 24, an option is out of range.
AnimationMesh animation_mesh(const DepthView& depth, const PixelRays& rays, double focal,
                             const std::uint8_t* labels, const Skeleton* skeleton,
                             const AnimationMeshOptions& options = {});

/// Which bones follow a pose.
enum class PoseScope : std::uint8_t {
  kLimbs,  ///< Arms and legs, against the trunk, which stays as it is.
  kBody    ///< All; the body turns with the pose, too.
};

/// How the bones of `source` move so that they point where those of `pose` point.
///
/// Directions alone are taken over: bones keep their lengths and the base of the spine its place.
/// From the trunk outwards each bone is turned as the bone before it, then by the shortest turn to
/// its new direction. With kLimbs directions are those against the trunk. A bone that is not
/// tracked in one of the two, or points backwards, moves with the bone before it.
/// @return  none: the torso of one of the two is not tracked.
std::optional<BoneMotions> follow_pose(const Skeleton& source, const Skeleton& pose,
                                       PoseScope scope);

enum class Skinning : std::uint8_t {
  /// As published: the polar angle from the optical axis and the azimuth of each vertex about its
  /// joint change as those of the bone. Rigid within the image plane, not towards the camera.
  kSpherical,
  kRigid,  ///< Each vertex turns with its bone.
  /// kRigid, blended linearly with the next bone over the last fifth of a bone; half and half at
  /// the joint.
  kLbs
};

/// Moves vertices (count, 3) of labelled bones of the person in pose `source`. Vertices of bones
/// that do not move keep their bits. The same bits on every CPU.
void animate(const float* vertices, const std::uint8_t* labels, std::int64_t count,
             const Skeleton& source, const BoneMotions& motions, Skinning method, float* out);

}  // namespace manip3d
