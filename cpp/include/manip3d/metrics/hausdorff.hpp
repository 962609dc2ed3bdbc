#pragma once

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct HausdorffOptions {
  double tolerance = 1e-4;  ///< Largest gap between the bounds, in diagonals of the original; > 0.
  int num_threads = 0;      ///< Number of threads; 0: all cores.
};

/// A distance lies between these, in the meshes' units.
struct DistanceBounds {
  double lower = 0.0;  ///< Reached at a point that was looked at, up to rounding.
  double upper = 0.0;  ///< Proved.
};

struct HausdorffResult {
  DistanceBounds forward;   ///< From the original's points to the simplified surface.
  DistanceBounds backward;  ///< From the simplified surface's points to the original.
  double diagonal = 0.0;  ///< Diagonal of the original's bounding box (vertices that a face uses).
};

/// The Hausdorff distance of two surfaces, as sets of points, between two bounds.
///
/// Branch and bound over the triangles of one surface [Tang, Lee & Kim, SIGGRAPH 2009]: a part is
/// done when it provably (PatchDistance, or the distance of its centre plus its radius) lies within
/// `tolerance` of the largest distance found; else it is halved. The same bits for any number of
/// threads.
/// @throws InputError  what check_mesh refuses; a mesh without faces; an original whose bounding
///                     box is a point; tolerance not > 0.
HausdorffResult hausdorff_bound(const MeshView& original, const MeshView& simplified,
                                const HausdorffOptions& options = {},
                                const Progress& progress = {});

}  // namespace manip3d
