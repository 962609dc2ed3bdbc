#pragma once

#include <cstdint>
#include <filesystem>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/mesh_file.hpp"

namespace manip3d {

/// A range image: a point or none for each pixel, row by row.
struct RangeGrid {
  std::int64_t num_rows = 0;
  std::int64_t num_cols = 0;
  Indices vertex;   ///< (num_rows * num_cols,) row of `points`; -1: no measurement.
  Vertices points;  ///< Points in the file's units and axes.
  Colors colors;    ///< sRGB of each point; empty: the file has no colours.
};

/// Reads the `range_grid` of a PLY file (Stanford's single scans), also of `.gz` and `.xz`.
/// @throws FormatError  as read_mesh; the file has no range grid.
RangeGrid read_range_grid(const std::filesystem::path& path, const ReadOptions& options = {},
                          const Progress& progress = {});

}  // namespace manip3d
