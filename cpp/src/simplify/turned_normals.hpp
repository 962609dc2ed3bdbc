#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Replaces normals of a simplified mesh that lie far from its surface. A corner takes over the
/// normal of a vertex that it collapsed onto, which may belong to another side of a hard edge, and
/// faces turn away from their normals. Faces as they were keep theirs, and so do faces whose
/// normals were far from them already, as those of foliage.
/// @param face_map  Input face -> face of `mesh`, or -1 if gone.
void mend_turned_normals(const MeshView& input, const std::vector<std::int32_t>& face_map,
                         TriangleMesh& mesh);

}  // namespace manip3d
