#pragma once

#include <cstdint>
#include <vector>

#include "geometry/bulk.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The vertices of a mesh in an order in which neighbours in space are mostly neighbours in memory.
/// Vertices at the same position have the same rank.
struct SpatialOrder {
  Bulk<std::int32_t> rank;    ///< Rank of each input vertex; -1 if it is in no face.
  Bulk<std::int32_t> source;  ///< Lowest input vertex with each rank.
};

/// Sort by Morton code on a grid of 1024 cells along the box, then by coordinates. `num_threads` as
/// in parallel_chunks(); the tables are allocated in the arena.
SpatialOrder spatial_order(const MeshView& mesh, const BoundingBox& box, int num_threads,
                           Arena& arena, const Progress& progress);

}  // namespace manip3d
