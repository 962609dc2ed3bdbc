#pragma once

#include <limits>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// Which triangles of three neighbouring pixels are a surface, of those that grid_mesh() makes.
struct DenseRule {
  /// Those without a longer edge; units of the points.
  double max_edge = std::numeric_limits<double>::infinity();
  /// Those whose z, positive in images, grows by no larger share of its least value.
  double max_step = std::numeric_limits<double>::infinity();
  void check() const;  ///< @throws InputError  one of the two is not > 0.
};

/// How much of a dense surface a mesh over some of its pixels covers.
struct DepthCoverage {
  double coverage = 1.0;  ///< Share of the dense surface's pixels in or on some triangle.
  /// Share of the mesh's area in space that lies over no dense triangle: of each triangle as much
  /// as of its pixels have no surface, or 2x2 cells that are cut.
  double bridges = 0.0;
};

/// Compares a mesh whose vertices are pixels with the dense surface of their grid.
/// A mesh without faces has no coverage; where there is no dense surface nothing is missing.
/// @param pixels    (n, 2) column and row of each vertex.
/// @throws InputError  as check_point_grid and DenseRule::check; a pixel or an index out of range.
DepthCoverage depth_coverage(const PointGridView& grid,
                             const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                             const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                             const DenseRule& rule = {});

}  // namespace manip3d
