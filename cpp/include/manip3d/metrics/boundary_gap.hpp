#pragma once

#include <cstdint>
#include <optional>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/metrics/metro.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct BoundaryGapOptions {
  double tolerance = 1e-3;  ///< Width of a crack, in diagonals.
  bool weld = true;         ///< Vertices with bit-identical positions count as one.
  int num_threads = 0;      ///< 0: all cores.
};

/// Lengths in the meshes' units. A mesh without boundary has no deviation; to such a mesh distances
/// are infinite.
struct BoundaryGap {
  std::optional<Deviation> forward;   ///< From the original's boundary curves to the simplified.
  std::optional<Deviation> backward;  ///< From the simplified boundary curves to the original's.
  std::int64_t cracks = 0;    ///< Simplified boundary edges with a point beyond the tolerance.
  double crack_length = 0.0;  ///< Summed length of those edges.
  double diagonal = 0.0;      ///< Diagonal of the original's bounding box.
};

/// How far the boundary curves of two meshes are from each other, and where the simplified one
/// tore.
///
/// A boundary edge is used by exactly one face that has three different vertices. Mean and RMS are
/// by length: each edge is cut into equal pieces of at most 1e-3 diagonals (of the larger mesh, for
/// the simplified one's edges), whose middles are measured; the maximum looks at the ends of the
/// edges as well. Cracks are decided to within a thousandth of the tolerance. Without welding every
/// seam of a glTF file is a boundary, on both sides, and a crack along it goes unnoticed until it
/// is wider than the tolerance. The same bits for any number of threads.
/// @throws InputError  what check_mesh refuses; a mesh without faces; an original whose bounding
///                     box is a point; tolerance not in [1e-6, 1].
BoundaryGap boundary_gap(const MeshView& original, const MeshView& simplified,
                         const BoundaryGapOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
