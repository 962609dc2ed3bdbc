#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/modify/phantom_image.hpp"

namespace manip3d {

/// Caller-owned memory for a mesh of up to `capacity` vertices and 2 * capacity triangles; as
/// DepthMesh.
struct PhantomMeshBuffers {
  std::int64_t capacity = 0;
  float* vertices = nullptr;          ///< (capacity, 3) metres.
  std::int32_t* pixels = nullptr;     ///< (capacity, 2) column u, row v.
  float* uvs = nullptr;               ///< (capacity, 2) v up; NaN behind the colour camera.
  std::int32_t* triangles = nullptr;  ///< (2 * capacity, 3) front faces look at the camera.
};

enum class Texturing : std::uint8_t {
  kSource,      ///< Each pixel's texture lies where its source pixel is.
  kCalibration  ///< Where the colour camera sees the pixel's own point: wrong for the phantom.
};

struct PhantomMeshOptions {
  double max_depth_step = 0.05;  ///< Metres: no triangle spans more [Pajarola et al., 2003].
  Texturing texturing = Texturing::kSource;
};

/// The points of all pixels that show something, row by row. Writes vertices and pixels;
/// `vertex_of` (rows * cols) gets the number of each pixel's vertex.
/// @throws InputError  the capacity is too small.
std::int64_t write_points(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                          const PhantomMeshBuffers& out, std::vector<std::int32_t>& vertex_of);

struct PhantomMeshSize {
  std::int64_t num_vertices = 0, num_triangles = 0;
};

/// Two triangles for each 2 x 2 cell of four pixels, cut along the shorter diagonal, one where
/// three show something; none over a larger step of depth. Writes uvs and triangles.
///
/// Where body and phantom meet, their textures lie at different places. A triangle across has
/// vertices of its own instead of the body's, with the texture of the phantom's corner, after the
/// `num_points` others; where the capacity does not reach, it is left out.
/// @param registration  where the colour camera stands; null: colour has the pixels of the depth.
PhantomMeshSize write_mesh(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                           std::int64_t num_points, const std::vector<std::int32_t>& vertex_of,
                           const Registration* registration, const PhantomMeshOptions& options,
                           const PhantomMeshBuffers& out);

}  // namespace manip3d
