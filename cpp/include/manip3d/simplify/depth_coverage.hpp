#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// Limits for the triangles of grid_mesh() that count as surface.
struct DenseRule {
  /// Longest edge of a surface triangle; units of the points.
  double max_edge = std::numeric_limits<double>::infinity();
  /// Largest difference of z (positive in images) over such a triangle, as a share of its smallest
  /// z.
  double max_step = std::numeric_limits<double>::infinity();
  /// Focal length, pixels. If positive, z is a depth in metres, and differences that DepthStep
  /// accepts at this focal length are allowed as well: in images with coarse pixels, the depth of a
  /// floor changes by more than `max_step` from one pixel to the next.
  double focal = 0.0;
  void check() const;  ///< @throws InputError  one of the first two is not > 0, or focal is < 0.
};

/// Share of a dense surface that a mesh over some of its pixels covers.
struct DepthCoverage {
  /// Share of the pixels of the dense surface that lie in or on some triangle. With a limit on
  /// steps, the depth of the triangle must also differ from that of the pixel by less than the
  /// limit.
  double coverage = 0.0;
  /// Share of the mesh's area in space where there is no dense triangle, slivers along contours
  /// included: each triangle is clipped to the missing dense triangles, and its area counts by
  /// their share of its area in the grid.
  double bridges = 0.0;
  /// The part of `bridges` over cells whose dense triangles filled pixels complete.
  double filled = 0.0;
  double outside = 0.0;  ///< Share of the valid pixels that no triangle of the dense surface uses.
};

/// Compare a mesh whose vertices are pixels with the dense surface of their grid. If the mesh has
/// no faces or the grid no dense surface, the coverage is 0; in the latter case the whole area
/// counts as bridges.
/// @param pixels    (n, 2) column and row of each vertex.
/// @param filled    (k, 2) column and row of pixels without surface that the mesh closes on
/// purpose.
/// @throws InputError  as check_point_grid and DenseRule::check; a pixel or an index out of range.
DepthCoverage depth_coverage(
    const PointGridView& grid, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
    const Eigen::Ref<const Rows<std::int32_t, 3>>& faces, const DenseRule& rule = {},
    const Eigen::Ref<const Rows<std::int32_t, 2>>& filled = Rows<std::int32_t, 2>());

/// For each face of such a mesh, compute the share of its pixels, without the corners, whose depth
/// differs from the face by a step. Negative if most of them have no surface, so that the share is
/// unknown.
/// @throws InputError  as depth_coverage().
std::vector<float> faces_off_surface(const PointGridView& grid,
                                     const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                     const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                     const DenseRule& rule);

}  // namespace manip3d
