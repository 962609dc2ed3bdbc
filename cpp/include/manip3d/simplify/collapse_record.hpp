#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The number of faces after each collapse (removed, kept) of a record of any simplifier: a face
/// goes when two of its corners have become one vertex. O(C + F log F) time.
/// @throws InputError  what check_mesh refuses; a vertex that is not in the mesh or is gone.
std::vector<std::int64_t> faces_left(
    const MeshView& mesh, const std::vector<std::pair<std::int32_t, std::int32_t>>& collapses,
    const Progress& progress = {});

}  // namespace manip3d
