#pragma once

#include <array>
#include <limits>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// A mesh whose vertices are pixels, in 32-bit buffers that a GPU can use directly.
struct DepthMesh {
  Rows<float, 3> vertices;       ///< (n, 3), points of the grid, unchanged.
  Rows<std::int32_t, 2> pixels;  ///< (n, 2) column u and row v of each vertex.
  Rows<float, 2> texcoords;      ///< (n, 2) texture coordinates, v up.
  Rows<std::int32_t, 3> faces;   ///< (m, 3); front faces look at the sensor.
};

/// Caller-owned memory for a DepthMesh of up to `capacity` vertices and 2 * capacity faces.
struct DepthMeshBuffers {
  std::int64_t capacity = 0;
  float* vertices = nullptr;       ///< (capacity, 3)
  std::int32_t* pixels = nullptr;  ///< (capacity, 2)
  float* texcoords = nullptr;      ///< (capacity, 2); v up; NaN: not on the image.
  std::int32_t* faces = nullptr;   ///< (2 * capacity, 3)
};

struct GridMeshOptions {
  /// Triangles with a longer edge are left out; units of the points.
  double max_edge = std::numeric_limits<double>::infinity();
  int num_threads = 0;  ///< 0: all cores.
};

/// Triangulate all valid pixels of a grid: two triangles for each 2x2 cell of four valid pixels,
/// cut along the shorter diagonal, and one triangle if three are valid. Texture coordinates are
/// those of registered_texcoord(), or of grid_texcoord() without a registration. The result is the
/// same for any number of threads.
/// @throws InputError  as check_point_grid; max_edge is not > 0.
DepthMesh grid_mesh(const PointGridView& grid, const GridMeshOptions& options = {},
                    const Registration* registration = nullptr);

/// Texture coordinates of the centre of pixel (u, v) in an image of the given size: ((u + 1/2) /
/// width, 1 - (v + 1/2) / height).
inline std::array<float, 2> grid_texcoord(double u, double v, double width, double height) {
  return {static_cast<float>((u + 0.5) / width), static_cast<float>(1.0 - (v + 0.5) / height)};
}

/// Whether texture coordinates lie on their image; false for NaN.
inline bool is_on_image(float s, float t) {
  return s >= 0.0F && s <= 1.0F && t >= 0.0F && t <= 1.0F;
}

/// grid_texcoord() of a place that may lie beside the image or be NaN; the result is then NaN.
inline std::array<float, 2> seen_texcoord(double u, double v, double width, double height) {
  constexpr float kUnseen = std::numeric_limits<float>::quiet_NaN();
  const auto uv = grid_texcoord(u, v, width, height);
  return is_on_image(uv[0], uv[1]) ? uv : std::array{kUnseen, kUnseen};
}

/// Texture coordinates of a point in a registered colour image; NaN behind the colour camera and
/// beside its image.
inline std::array<float, 2> registered_texcoord(const std::array<float, 3>& point,
                                                const Registration& registration) {
  const Eigen::Vector3d p(point[0], point[1], point[2]);
  const Eigen::Vector2d pixel =
      project(registration.color, registration.rotation * p + registration.translation);
  return seen_texcoord(pixel.x(), pixel.y(), static_cast<double>(registration.color.width),
                       static_cast<double>(registration.color.height));
}

}  // namespace manip3d
