#pragma once

#include <limits>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// A mesh whose vertices are pixels: 32-bit buffers as a GPU takes them.
struct DepthMesh {
  Rows<float, 3> vertices;          ///< (n, 3), unchanged points of the grid.
  Rows<std::int32_t, 2> pixels;     ///< (n, 2) column u and row v of each, in row-major order.
  Rows<float, 2> uvs;               ///< (n, 2) texture coordinates, v up.
  Rows<std::int32_t, 3> triangles;  ///< (m, 3); front faces look at the sensor.
};

struct GridMeshOptions {
  /// Triangles with a longer edge are left out; units of the points.
  double max_edge = std::numeric_limits<double>::infinity();
  int num_threads = 1;
};

/// The dense mesh of a grid: all valid pixels; two triangles for each 2x2 cell of four of them,
/// cut along the shorter diagonal, and one where three are valid. UVs are those of
/// grid_uvs(). The same for any number of threads.
/// @throws InputError  as check_point_grid; max_edge is not > 0.
DepthMesh grid_mesh(const PointGridView& grid, const GridMeshOptions& options = {});

/// Texture coordinates of pixel centres in an image of the same size: ((u + 1/2) / cols,
/// 1 - (v + 1/2) / rows).
void grid_uvs(const Rows<std::int32_t, 2>& pixels, std::int64_t rows, std::int64_t cols,
              Rows<float, 2>& uvs);

/// Texture coordinates in a registered colour image; NaN for points behind the colour camera.
void registered_uvs(const Rows<float, 3>& vertices, const Registration& registration,
                    Rows<float, 2>& uvs);

}  // namespace manip3d
