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
  /// Largest error of a step, input units.
  double max_error = std::numeric_limits<double>::infinity();
  /// Weight of the planes along boundaries and rims of thin shells; the surface itself has 1.
  double boundary_weight = 1.0;
  /// Weight of the planes along borders of materials and texture charts. If more than half of the
  /// edges of more than half of the vertices are such borders, sharp edges aside, then those
  /// between two such vertices have no planes.
  double seam_weight = 1.0;
  /// Weight of the planes along lines of equal colour, where colours of vertices do not change
  /// linearly. 0: colours are only interpolated, and decide whether a part that vanishes is
  /// missed.
  double color_weight = 0.01;
  std::vector<bool> locked;         ///< Vertices that must not move; empty: none.
  std::vector<std::int32_t> looks;  ///< By material, as QualityOptions::looks.
  int num_threads = 0;              ///< 0: all cores of this process.
};

/// Fast edge collapse in batches, on any triangle soup, with vertices where the quadric error is
/// least.
///
/// The rules are those of simplify_quality(): nothing is locked by default. No face turns over and
/// no edge gets a third face as long as the target can be reached without it. The rule on third
/// faces is also waived if it would move the surface more than three times as far, by a visible
/// distance.
///
/// First, vertices at the same position are welded, and so are the ends of edges whose length is
/// only a rounding error, as at poles; duplicate faces are removed, and everything is sorted in
/// space. Then passes follow: all edges are priced by the sum of the quadrics of their
/// ends [Garland & Heckbert 1997], and those below a limit are collapsed from the cheapest one on,
/// each vertex at most once per pass. Blocks of faces are processed independently; edges across
/// their borders follow in blocks that are eight times as large, and so on. The blocks do not
/// depend on the number of threads, so neither does the result. O(V + F) for each of O(log(F /
/// target)) passes.
///
/// Vertices and faces of the result are in a spatial order. The error of a step is the root mean
/// square distance of the new vertex to the planes of the faces and borders that it represents.
/// @throws InputError  as check_mesh(); a bounding box without a finite diagonal; an option out of
///                     range.
QualityResult simplify_fast(const MeshView& mesh, const FastOptions& options,
                            const Progress& progress = {});

}  // namespace manip3d
