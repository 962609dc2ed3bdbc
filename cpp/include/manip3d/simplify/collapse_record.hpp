#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Count the faces after each collapse (removed, kept) in the record of any simplifier: a face is
/// removed once two of its corners are the same vertex. The time is that of visiting, in each
/// collapse, all faces that the removed vertex ever had.
/// @throws InputError  as check_mesh; a vertex that is not in the mesh or was already removed.
std::vector<std::int64_t> faces_left(
    const MeshView& mesh, const std::vector<std::pair<std::int32_t, std::int32_t>>& collapses,
    const Progress& progress = {});

}  // namespace manip3d
