#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {

/// The points of all pixels that show something, row by row. Writes vertices and pixels;
/// `vertex_of` (rows * cols) gets the number of each pixel's vertex.
/// @throws InputError  the capacity is too small.
std::int64_t write_points(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                          const DepthMeshBuffers& out, std::vector<std::int32_t>& vertex_of);

/// Two triangles for each 2 x 2 cell of four pixels, cut along the shorter diagonal, one where
/// three show something; none over a larger step of depth. Writes texcoords and faces.
///
/// Where body and phantom meet, their textures lie at different places. A triangle across has
/// vertices of its own instead of the body's, with the texture of the phantom's corner, after the
/// `num_points` others; where the capacity does not reach, it is left out.
/// @param registration  where the colour camera stands; null: colour has the pixels of the depth.
PhantomMeshSize write_mesh(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                           std::int64_t num_points, const std::vector<std::int32_t>& vertex_of,
                           const Registration* registration, const PhantomMeshOptions& options,
                           const DepthMeshBuffers& out);

}  // namespace manip3d
