#pragma once

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct HausdorffOptions {
  /// Largest difference of the bounds, in diagonals of the original; at least 1e-12, and at least
  /// 1e-12 of the largest distance of a used vertex from the original's centre along an axis.
  double tolerance = 1e-4;
  int num_threads = 0;  ///< Number of threads; 0: all cores.
};

/// Bounds of a distance, in the meshes' units.
struct DistanceBounds {
  double lower = 0.0;  ///< Distance at a point that was measured, exact up to rounding.
  double upper = 0.0;  ///< Proved upper bound.
};

struct HausdorffResult {
  DistanceBounds forward;   ///< From the original's points to the simplified surface.
  DistanceBounds backward;  ///< From the simplified surface's points to the original.
  double diagonal = 0.0;  ///< Diagonal of the original's bounding box (vertices that a face uses).
};

/// Bound the Hausdorff distance of two surfaces, as sets of points, from below and above.
///
/// Branch and bound over the triangles of one surface [Tang, Lee & Kim, SIGGRAPH 2009]: a part is
/// finished when it is proved (by PatchDistance, or by the distance of its centre plus its radius)
/// to lie within the largest distance found plus `tolerance`; otherwise it is halved. The result
/// has the same bits for any number of threads.
/// @throws InputError  as check_mesh; a mesh without faces; an original whose bounding box is a
///                     point; tolerance too small for the size of the meshes.
HausdorffResult hausdorff_bound(const MeshView& original, const MeshView& simplified,
                                const HausdorffOptions& options = {},
                                const Progress& progress = {});

}  // namespace manip3d
