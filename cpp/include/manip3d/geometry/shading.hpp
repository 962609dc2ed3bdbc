#pragma once

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Data that rendering a mesh needs and files seldom contain.
namespace manip3d {

struct ShadingNormals {
  Vertices normals;    ///< (K, 3) unit length, each value once.
  Faces face_normals;  ///< (F, 3) row of `normals` for each corner; never -1.
};

/// Compute a normal for each corner of each face: the mesh's own if the corner has one; else the
/// mean over the faces around the corner's position that form at most the crease angle with the
/// corner's face, each weighted by its angle there [Thuermer & Wuethrich, JGT 3(1), 1998].
///
/// Vertices at equal positions are treated as one, so that texture seams are not visible. A normal
/// never points to the back of its face, even if that of the file does. Around a vertex of more
/// than 512 corners, all faces are averaged. O(sum of min(valence, 512)^2) time.
/// @param crease_angle_deg  in [0, 180]; 0 gives each face its own normal.
/// @throws InputError  crease angle out of range, or an invalid mesh.
ShadingNormals shading_normals(const MeshView& mesh, double crease_angle_deg, int num_threads = 0);

/// Return the (E, 2) vertices of the edges that exactly one face uses when vertices at equal
/// positions are treated as one; of several such vertices, the first is returned.
/// @throws InputError  an invalid mesh.
Rows<std::int32_t, 2> welded_boundary(const MeshView& mesh);

}  // namespace manip3d
