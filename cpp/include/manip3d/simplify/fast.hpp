#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
#include "manip3d/simplify/quality.hpp"

namespace manip3d {

struct FastOptions {
  std::int64_t target_faces = 0;  ///< Stop at this many faces or fewer; 0: as few as possible.
  double max_error = std::numeric_limits<double>::infinity();  ///< Limit of a step, input units.
  double boundary_weight = 1.0;  ///< Weight of the planes along boundaries; a surface has 1.
  double seam_weight = 1.0;      ///< Weight along borders of materials and texture charts.
  std::vector<bool> locked;      ///< Vertices that stay where they are; empty: none.
  int num_threads = 0;           ///< 0: as many as this process may use.
};

/// Edge collapse in batches, for speed: on any triangle soup, like simplify_quality(), whose rules
/// hold here too (nothing is locked, no face turns over, as long as the target can be reached so;
/// no edge gets a third face, as long as that costs less than three times the distance of what it
/// forbids, or cannot be seen), with vertices where the quadric error is least.
///
/// Vertices at the same place are welded, equal faces are taken once, and everything is sorted in
/// space first. Then passes: all edges are priced by the sum of their ends' quadrics [Garland &
/// Heckbert 1997], and those below a limit collapse from the cheapest one on, each vertex at most
/// once in a pass. Blocks of faces work independently; what crosses their borders follows in blocks
/// that are eight times as large, and so on. The blocks do not depend on the number of threads, so
/// neither does the result.
/// O(V + F) for each pass, of which there are O(log(F / target)).
///
/// Vertices and faces come out in an order in space. The error of a step is the root mean square
/// distance of the new vertex to the planes of the faces and borders that it stands for.
/// @throws InputError  as check_mesh(); a bounding box without a finite diagonal; an option out of
///                     range.
QualityResult simplify_fast(const MeshView& mesh, const FastOptions& options,
                            const Progress& progress = {});

}  // namespace manip3d
