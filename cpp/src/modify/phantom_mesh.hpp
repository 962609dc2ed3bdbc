#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "modify/phantom_image.hpp"

namespace manip3d {

/// Writes the points of all pixels that are not empty, row by row, as vertices and pixels.
/// `vertex_of` (rows * cols) gets the index of each pixel's vertex. Returns the number of points.
/// @throws InputError  the capacity is too small.
std::int64_t write_points(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                          const DepthMeshBuffers& out, std::vector<std::int32_t>& vertex_of);

/// Writes faces and texcoords: two triangles for each 2 x 2 cell of four non-empty pixels, cut
/// along the shorter diagonal, and one triangle for three of them. Triangles that span a larger
/// depth difference than `options.max_depth_step` are left out.
///
/// At the seam of body and phantom their texture coordinates differ. A triangle across this seam
/// uses new vertices in place of those of the body, with the texture coordinate of the phantom's
/// corner. They follow the `num_points` others. If the capacity is exhausted, the triangle is left
/// out.
/// @param registration  Registration of the colour camera; null: the colour image has the pixels of
///                      the depth image.
PhantomMeshSize write_mesh(const PhantomImage& image, const PixelBox& box, const PixelRays& rays,
                           std::int64_t num_points, const std::vector<std::int32_t>& vertex_of,
                           const Registration* registration, const PhantomMeshOptions& options,
                           const DepthMeshBuffers& out);

}  // namespace manip3d
