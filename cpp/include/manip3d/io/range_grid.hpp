#pragma once

#include <cstdint>
#include <filesystem>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/mesh_file.hpp"

namespace manip3d {

/// A range image: one point per pixel or none, row by row.
struct RangeGrid {
  std::int64_t num_rows = 0;
  std::int64_t num_cols = 0;
  Indices vertex;   ///< (num_rows * num_cols,) row of `points`, -1 = no measurement.
  Vertices points;  ///< In the file's own units and axes.
};

/// Reads the `range_grid` of a PLY file (Stanford's single scans); `.gz` and `.xz` too.
/// @throws FormatError  as read_mesh, and when the file holds no range grid.
RangeGrid read_range_grid(const std::filesystem::path& path, const ReadOptions& options = {},
                          const Progress& progress = {});

}  // namespace manip3d
