#pragma once

#include "manip3d/geometry/mesh.hpp"

/// @file
/// What a picture of a mesh needs and a file seldom has.
namespace manip3d {

struct ShadingNormals {
  Vertices normals;    ///< (K, 3) unit length, each value once.
  Faces face_normals;  ///< (F, 3) row of `normals` for each corner; never -1.
};

/// A normal for each corner of each face: the mesh's own where it has one, else the mean over the
/// faces around the corner's position that are within the crease angle of the corner's face, each
/// weighted by its angle there [Thuermer & Wuethrich, JGT 3(1), 1998].
///
/// Vertices at equal positions count as one, so that a texture seam does not show. A normal never
/// points to the back of its face, also where the file's does. Around a vertex of more than 512
/// corners every face counts. O(sum of min(valence, 512)^2) time.
/// @param crease_angle_deg  in [0, 180]; 0 gives each face its own normal.
/// @throws InputError  crease angle out of range, or an invalid mesh.
ShadingNormals shading_normals(const MeshView& mesh, double crease_angle_deg, int num_threads = 0);

/// (E, 2) vertices of the edges that exactly one face uses, once vertices at equal positions are
/// one; of several such vertices the first is given.
/// @throws InputError  an invalid mesh.
Rows<std::int32_t, 2> welded_boundary(const MeshView& mesh);

}  // namespace manip3d
