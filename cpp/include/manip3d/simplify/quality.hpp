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
  /// Largest error of a step, input units.
  double max_error = std::numeric_limits<double>::infinity();
  /// Largest Hausdorff distance between the two surfaces, boundaries included, input units, > 0. It
  /// is guaranteed. With this limit no piece vanishes and no rule is broken, even if the target is
  /// missed.
  double max_distance = std::numeric_limits<double>::infinity();
  /// Price of a strip along a boundary, relative to a shifted surface.
  double boundary_weight = 1.0;
  double seam_weight = 3.0;  ///< The same along borders of materials and texture charts.
  /// Price of a shifted texture, averaged over the textured surface, relative to a shifted surface.
  double texture_weight = 0.2;
  /// Whether the material shows a picture. If not, the prices of shifted textures and of seams
  /// between charts of one material are divided by ten: texture coordinates are kept for later use,
  /// but only the shape is visible.
  bool texture_seen = true;
  /// Price of colours of vertices that are wrong on average by as much as they change over a step,
  /// relative to a surface that is shifted by this step. 0: colours are only interpolated,
  /// and decide whether a part that vanishes is missed.
  double color_weight = 0.01;
  std::vector<bool> locked;  ///< Vertices that must not move; empty: none.
  /// Factor, > 0, of each vertex on the price of changes of the surface there. Empty: all 1.
  std::vector<double> importance;
  /// By material: a number that materials share if they look the same. Where a removed piece
  /// uncovers a surface of another look, its removal is seen even if that surface is near. Empty:
  /// each material has a look of its own.
  std::vector<std::int32_t> looks;
};

struct QualityResult {
  TriangleMesh mesh;  ///< Compact; materials are left to the caller.
  /// Input vertex -> output vertex that represents it, or -1.
  std::vector<std::int32_t> vertex_map;
  std::vector<std::int32_t> face_map;  ///< Input face -> output face, or -1 if removed.
  double max_error = 0.0;              ///< Largest error among the steps made, input units.
  CollapseStop stop = CollapseStop::kTargetReached;
  std::array<std::int64_t, kNumRejections> rejected{};  ///< Rejected candidates, by Rejection.
  std::int64_t removed_pieces = 0;     ///< Pieces removed as a whole, because that cost least.
  std::int64_t relaxed_collapses = 0;  ///< Collapses that broke a rule, to reach the target.
  std::int64_t dropped_faces = 0;      ///< Input faces with a repeated vertex; they are left out.
  std::optional<double>
      distance_bound;  ///< Upper bound of the Hausdorff distance, with max_distance.
};

/// Edge collapse with vertices where the error is least, on any triangle soup: boundaries,
/// non-manifold edges, many pieces, several materials and texture coordinates per vertex, faces
/// without any. Vertices at the same position are treated as different; weld them first.
///
/// The price of each step has the unit of volume: the integral over the surface of the distance by
/// which it is shifted. It has terms for the faces around the edge [Lindstrom & Turk 1998: the
/// current faces, memoryless], for the strips that boundaries and seams sweep, for the texture
/// [Hoppe 1999] on both sides of a seam, including that of a neighbouring chart if a chart
/// vanishes, and for the colours of vertices. The step with the least price per removed face is
/// next. A new vertex minimizes the squared distances and preserves the volume. A piece (faces
/// connected by vertices) may vanish as a whole, at a price for the distance of its surface and its
/// borders to the rest, or where it can be seen for a difference of its look (material or colour)
/// from that of the rest; if that would be visible, its last faces are flattened first where that
/// costs less. At the end, vertices that are far off the original faces they represent are moved
/// back, and all are fitted to the original surface, texture coordinates within their charts.
///
/// Apart from that, no face turns over, no face is degenerate or duplicate, and no edge gets a
/// third face, as long as the target can be reached without it. Locked vertices always stay, with
/// their texture coordinates and their pieces. Deterministic for any number of threads. O(E log E)
/// time, O(V + F) memory.
/// @throws InputError  as check_mesh(); a bounding box without a finite diagonal; an option out of
///                     range.
QualityResult simplify_quality(const MeshView& mesh, const QualityOptions& options,
                               const Progress& progress = {});

}  // namespace manip3d
