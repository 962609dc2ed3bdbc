#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// Which triangles of three neighbouring pixels are a surface, of those that grid_mesh() makes.
struct DenseRule {
  /// The longest edge of a surface triangle; units of the points.
  double max_edge = std::numeric_limits<double>::infinity();
  /// The largest growth of z, positive in images, over such a triangle, as a share of its least z.
  double max_step = std::numeric_limits<double>::infinity();
  /// Pixels. If positive, z is a depth in metres, and what DepthStep connects at this focal length
  /// is no step either: where pixels are coarse, a floor grows by more than `max_step` from one to
  /// the next.
  double focal = 0.0;
  void check() const;  ///< @throws InputError  one of the first two is not > 0, or focal is < 0.
};

/// How much of a dense surface a mesh over some of its pixels covers.
struct DepthCoverage {
  /// Share of the dense surface's pixels in or on some triangle; with a limit on steps only where
  /// the triangle is no farther away than that from the pixel, in depth.
  double coverage = 0.0;
  /// Share of the mesh's area in space that lies over no dense triangle: of each triangle as much
  /// as of its pixels have no surface. A pixel stands for the 2x2 cell above and right of it where
  /// that lies in the triangle, and for half a cell where one of its two dense triangles is there.
  double bridges = 0.0;
  double outside = 0.0;  ///< Share of the valid pixels that no triangle of the dense surface uses.
};

/// Compares a mesh whose vertices are pixels with the dense surface of their grid.
/// A mesh without faces has no coverage, nor has one where there is no dense surface: all of its
/// area is a bridge then.
/// @param pixels    (n, 2) column and row of each vertex.
/// @throws InputError  as check_point_grid and DenseRule::check; a pixel or an index out of range.
DepthCoverage depth_coverage(const PointGridView& grid,
                             const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                             const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                             const DenseRule& rule = {});

/// For each face of such a mesh: the share of its pixels, corners aside, that lie a step in depth
/// away from it. Below 0 where most of them have no surface, so that nothing can be said.
/// @throws InputError  as depth_coverage().
std::vector<float> faces_off_surface(const PointGridView& grid,
                                     const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                     const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                     const DenseRule& rule);

}  // namespace manip3d
