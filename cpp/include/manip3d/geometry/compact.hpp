#pragma once

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Removes the vertices, texture coordinates and normals that no face uses; the others keep their
/// order. Indices must be in range (check_mesh).
/// @return  (V,) old vertex -> new vertex, or -1 if it is gone.
Indices remove_unreferenced(TriangleMesh& mesh);

}  // namespace manip3d
