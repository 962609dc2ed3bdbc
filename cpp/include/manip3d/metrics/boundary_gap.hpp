#pragma once

#include <cstdint>
#include <optional>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/metrics/metro.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct BoundaryGapOptions {
  double tolerance = 1e-3;  ///< Smallest width of a crack, in diagonals of the original.
  bool weld = true;         ///< Treat vertices with bit-identical positions as one.
  int num_threads = 0;      ///< 0: all cores.
};

/// Lengths are in the meshes' units. A mesh without boundary has no deviation, and distances to it
/// are infinite.
struct BoundaryGap {
  /// From the original's boundary curves to those of the simplified mesh.
  std::optional<Deviation> forward;
  /// From the simplified mesh's boundary curves to those of the original.
  std::optional<Deviation> backward;
  std::int64_t cracks = 0;    ///< Simplified boundary edges with a point beyond the tolerance.
  double crack_length = 0.0;  ///< Summed length of those edges.
  double diagonal = 0.0;      ///< Diagonal of the original's bounding box.
};

/// Measure the distances between the boundary curves of two meshes, and find where the simplified
/// mesh tore.
///
/// A boundary edge is used by exactly one face that has three different vertices. Mean and RMS are
/// weighted by length: each edge is cut into equal pieces of at most 1e-3 diagonals (for edges of
/// the simplified mesh, diagonals of the larger mesh), whose midpoints are measured; the maximum
/// includes the ends of the edges. Cracks are decided to within a thousandth of the tolerance.
/// Without welding, every seam of a glTF file is a boundary in both meshes, and a crack along it is
/// not noticed until it is wider than the tolerance. The result has the same bits for any number of
/// threads.
/// @throws InputError  as check_mesh; a mesh without faces; an original whose bounding box is a
///                     point; tolerance not in [1e-6, 1].
BoundaryGap boundary_gap(const MeshView& original, const MeshView& simplified,
                         const BoundaryGapOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
