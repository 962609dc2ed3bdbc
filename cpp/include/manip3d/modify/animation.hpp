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
  /// Triangles join only pixels of the same bone, or of two bones that meet at a joint. If false,
  /// limbs drag along the surface that they lie on (figure 5.5).
  bool by_label = true;
  /// Two bones with exactly one bone between them (upper arm and chest at the shoulder) may share
  /// triangles within this distance, in metres, of the joint between them. 0: never, as published.
  double joint_reach = 0.15;
};

/// The labelled pixels of a person as a mesh whose parts can move at the joints.
struct AnimationMesh {
  Rows<float, 3> vertices;           ///< (n, 3) metres, row by row of the image.
  Rows<std::int32_t, 2> pixels;      ///< (n, 2) column and row.
  std::vector<std::uint8_t> labels;  ///< (n,) bone, 1 to 24.
  Rows<std::int32_t, 3> faces;       ///< (m, 3); front faces look at the camera.
};

/// Triangulate the labelled pixels. Cells of 2x2 pixels are cut as by grid_mesh(). A triangle is
/// kept if the depths of its pixels are connected (DepthStep) and their bones may share a triangle
/// (AnimationMeshOptions).
/// @param labels    (rows, cols) bone of each pixel, 0: not the person.
/// @param skeleton  Source of the joints for `joint_reach`. Null: only bones that meet share
///                  triangles.
/// @throws InputError  sizes differ, a label above 24, an option is out of range.
AnimationMesh animation_mesh(const DepthView& depth, const PixelRays& rays, double focal,
                             const std::uint8_t* labels, const Skeleton* skeleton,
                             const AnimationMeshOptions& options = {});

/// Bones that follow a pose.
enum class PoseScope : std::uint8_t {
  kLimbs,  ///< Arms and legs, relative to the trunk, which does not move.
  kBody    ///< All bones; the body also takes the orientation of the pose.
};

/// Motions of the bones of `source` after which they point in the directions of the bones of
/// `pose`.
///
/// Only directions are transferred: bones keep their lengths, and the base of the spine keeps its
/// place. From the trunk outwards, each bone first turns with its parent bone, then by the shortest
/// rotation to its new direction. With kLimbs, directions are relative to the trunk. A bone moves
/// rigidly with its parent if it is not tracked in one of the two skeletons, or if its new
/// direction is opposite to the one after that turn, because the shortest rotation is undefined.
/// @return  No value if the torso of one of the two skeletons is not tracked.
std::optional<BoneMotions> follow_pose(const Skeleton& source, const Skeleton& pose,
                                       PoseScope scope);

enum class Skinning : std::uint8_t {
  /// The published method: the polar angle from the optical axis and the azimuth of each vertex
  /// about its joint change by as much as those of the bone. Rigid within the image plane, but not
  /// towards the camera.
  kSpherical,
  kRigid,  ///< Each vertex turns with its bone.
  /// Linear blend skinning: kRigid, blended linearly with the next bone over the last fifth of a
  /// bone, with equal weights at the joint.
  kLbs
};

/// Moves vertices (count, 3) of labelled bones of the person in pose `source`. Vertices
/// that no moving bone influences are copied bit for bit (with kLbs, those near a joint with a
/// moving bone are not). The result has the same bits on every CPU.
void animate(const float* vertices, const std::uint8_t* labels, std::int64_t count,
             const Skeleton& source, const BoneMotions& motions, Skinning method, float* out);

}  // namespace manip3d
