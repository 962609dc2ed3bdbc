#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
#include "manip3d/simplify/qem.hpp"

namespace manip3d {

struct QualityOptions {
  std::int64_t target_faces = 0;  ///< Stop at this many faces or fewer; 0: as few as possible.
  double max_error = std::numeric_limits<double>::infinity();  ///< Limit of a step, input units.
  /// Largest distance of the two surfaces (Hausdorff, boundaries included), input units, > 0; kept
  /// by construction. No piece vanishes then, and the rules hold even if the target is missed.
  double max_distance = std::numeric_limits<double>::infinity();
  double boundary_weight = 1.0;  ///< Price of a strip along a boundary; a shifted surface has 1.
  double seam_weight = 3.0;      ///< Price along borders of materials and texture charts.
  /// Price of a shifted texture, on average over the surface that shows one; a shifted surface
  /// has 1.
  double texture_weight = 0.2;
  /// Whether a picture is shown. If not, shifted textures and the seams between charts of one
  /// material count a tenth: texture coordinates are kept for later, but the shape is what is seen.
  bool texture_seen = true;
  std::vector<bool> locked;  ///< Vertices that stay where they are; empty: none.
  /// The factor, > 0, of each vertex on the price of changing the surface there. Empty: all 1.
  std::vector<double> importance;
};

struct QualityResult {
  TriangleMesh mesh;                     ///< Compact; materials are left to the caller.
  std::vector<std::int32_t> vertex_map;  ///< Input vertex -> the output vertex it became, or -1.
  std::vector<std::int32_t> face_map;    ///< Input face -> output face, or -1 if gone.
  double max_error = 0.0;                ///< Largest error among the steps made, input units.
  CollapseStop stop = CollapseStop::kTargetReached;
  std::array<std::int64_t, kNumRejections> rejected{};  ///< Candidates turned down, by Rejection.
  std::int64_t removed_pieces = 0;     ///< Pieces that vanished because that cost least.
  std::int64_t relaxed_collapses = 0;  ///< Made against the rules, to reach the target.
  std::int64_t dropped_faces = 0;      ///< Input faces with a repeated vertex, left out.
  std::optional<double>
      distance_bound;  ///< Upper bound of the Hausdorff distance, with max_distance.
};

/// Edge collapse with vertices where the error is least, on any triangle soup: boundaries,
/// non-manifold edges, many pieces, several materials and texture coordinates per vertex, faces
/// without any. Vertices at the same place are different ones: weld first.
///
/// Each step has a price in the unit of volume, the integral over the surface of how far it is
/// shifted: of the faces around the edge [Lindstrom & Turk 1998: as they are now, memoryless], of
/// the strips that boundaries and seams sweep, and of the texture [Hoppe 1999], that on the other
/// side of a seam included, and that of another chart where one vanishes. What costs least
/// per face comes next. A new vertex lies where the squared distances are least, with the volume
/// kept. A piece (faces joined by vertices) may vanish as a whole, for the distance of its surface
/// and of its borders to the rest; where that would be seen, its last faces become flat first, if
/// that costs less. In the end vertices that stand far out of the original faces
/// they stand for are drawn back, and all are fitted to the original surface, texture coordinates
/// within their charts.
///
/// Otherwise no face turns over, none is degenerate or double, and no edge gets a third face, as
/// long as the target can be reached so. Locked vertices stay in any case, with their texture
/// coordinates and the pieces that they are in. Deterministic for any number of threads. O(E log E)
/// time, O(V + F) memory.
/// @throws InputError  as check_mesh(); a bounding box without a finite diagonal; an option out of
///                     range.
QualityResult simplify_quality(const MeshView& mesh, const QualityOptions& options,
                               const Progress& progress = {});

}  // namespace manip3d
