#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Terms added for mesh boundaries (edges with exactly one face).
enum class BoundaryTerm : std::uint8_t {
  kNone,       ///< Boundaries have no effect (QEM_ORIG, QEM_TP).
  kFreeze,     ///< Boundary vertices never move; planes of constant weight (QEM_BP, QEM_BTP).
  kWeight,     ///< Planes of constant weight only [Garland & Heckbert 1997, sec. 6].
  kCurvature,  ///< Planes weighted by W_b and the boundary's curvature (QEM4VR, eq. 2.6).
};

/// Measure of the curvature of a boundary curve at a vertex (eq. 2.5).
enum class BoundaryCurvature : std::uint8_t {
  kTurning,  ///< |r' x r''| / (2 |r'|^2): dimensionless, independent of the file's unit.
  kPaper,    ///< |r' x r''| / |r'|^3 of the mesh scaled to a unit diagonal.
};

/// Terms added for texture coordinates and materials.
enum class TextureTerm : std::uint8_t {
  kNone,      ///< Attributes are kept but have no effect (QEM_ORIG, QEM_BP).
  kQuadric5,  ///< Quadrics over (x, y, z, u, v) per distinct UV (QEM_TP, QEM_BTP; eq. 2.7).
  /// Planes along seams, weight W_t; seam vertices stay on their seam unless the target cannot be
  /// reached otherwise (QEM4VR).
  kSeamPlanes,
  kSeamPaper,  ///< The quadric of a seam vertex is multiplied by W_t, as printed.
  kSeamLock,   ///< Seam vertices never move.
};

/// Places at which the link condition [Dey et al. 1999] is enforced.
enum class LinkCondition : std::uint8_t {
  kManifold,  ///< For edges whose two ends have a manifold neighbourhood.
  kAlways,
  kNever,
};

/// Whether edges that end in a complex vertex may collapse. A complex vertex is on the boundary,
/// but its number of boundary neighbours is not two.
enum class ComplexVertices : std::uint8_t {
  kKeep,    ///< The complex vertex stays; others may collapse onto it.
  kFreeze,  ///< No edge of it collapses, as printed.
};

struct QemOptions {
  std::int64_t target_faces = 0;  ///< Stop at this many faces or fewer; 0: as few as possible.
  double max_error =
      std::numeric_limits<double>::infinity();  ///< Largest error of one collapse, input units.
  /// Largest Hausdorff distance between the two surfaces, boundaries included, in input units; the
  /// guarantee is exact. 0: only collapses that do not change the surface as a set of points.
  double max_distance = std::numeric_limits<double>::infinity();
  BoundaryTerm boundary = BoundaryTerm::kCurvature;
  double boundary_weight = 5.0;  ///< W_b.
  BoundaryCurvature curvature = BoundaryCurvature::kTurning;
  TextureTerm texture = TextureTerm::kSeamPlanes;
  /// W_t: weight of seam planes, or factor on the quadric (kSeamPaper).
  double seam_weight = 100.0;
  ComplexVertices complex_vertices = ComplexVertices::kKeep;
  LinkCondition link_condition = LinkCondition::kManifold;
  double quality_threshold =
      0.0;  ///< Divide the cost by min(worst new face quality, this); 0: off.
};

enum class CollapseStop : std::uint8_t {
  kTargetReached,
  kErrorLimit,       ///< All remaining collapses are above max_error (or not legal).
  kDistanceLimit,    ///< No remaining collapse is known to keep max_distance (or is legal).
  kNoLegalCollapse,  ///< No remaining collapse keeps the mesh valid.
  /// The method does not support this mesh, which is returned without collapses (faces with a
  /// repeated vertex and unused vertices are left out).
  kRefused,
};

/// Reasons to reject a candidate collapse; each is a counter of QemResult::rejected.
enum class Rejection : std::uint8_t {
  kFlip,           ///< A face would turn by more than about 78 degrees.
  kDegenerate,     ///< A face would lose its area.
  kDuplicate,      ///< Two faces would have the same vertices.
  kLink,           ///< The link condition fails.
  kBoundaryLoop,   ///< A boundary loop would fall below three edges.
  kComplexVertex,  ///< The edge ends in a complex vertex (ComplexVertices::kFreeze).
  kTextureFlip,    ///< A face would flip in texture space.
  kAttribute,      ///< A corner would have no texture coordinate of its material at the new vertex,
                   ///< or a locked vertex one of another vertex.
  kErrorLimit,     ///< Above max_error.
  kDistanceLimit,  ///< The result is not known to keep max_distance.
};
inline constexpr int kNumRejections = 10;
inline constexpr std::array<const char*, kNumRejections> kRejectionNames = {
    "flip",           "degenerate",   "duplicate", "link_condition", "boundary_loop",
    "complex_vertex", "texture_flip", "attribute", "error_limit",    "distance_limit"};

/// One collapse: `removed` is moved onto `kept` (input vertex indices), at this error (input
/// units).
struct Collapse {
  std::int32_t removed;
  std::int32_t kept;
  double error;
};

struct QemResult {
  TriangleMesh mesh;  ///< Compact; materials are left to the caller.
  /// Input vertex -> output vertex that represents it, or -1.
  std::vector<std::int32_t> vertex_map;
  std::vector<std::int32_t> kept;      ///< Output vertex -> input vertex at its place.
  std::vector<std::int32_t> face_map;  ///< Input face -> output face, or -1 if removed.
  std::vector<Collapse> collapses;     ///< In order; see replay_collapses().
  double max_error = 0.0;              ///< Largest error among the collapses made, input units.
  /// Upper bound of the Hausdorff distance from the input, input units; only if max_distance is
  /// given.
  std::optional<double> distance_bound;
  CollapseStop stop = CollapseStop::kTargetReached;
  std::string message;                                  ///< Reason of kRefused.
  std::array<std::int64_t, kNumRejections> rejected{};  ///< Rejected candidates, by Rejection.
  std::int64_t off_seam_collapses = 0;  ///< Seam vertices that had to leave their seam.
  std::int64_t locked_vertices = 0;     ///< Vertices that the method never moves.
  std::int64_t dropped_faces = 0;       ///< Input faces with a repeated vertex; they are left out.
  std::int64_t clamped_costs = 0;       ///< Errors that rounding made negative; they count as zero.
};

/// Edge collapse with subset placement, ordered by quadric error [Garland & Heckbert 1997], with
/// the boundary and texture terms of QEM4VR and of the baselines it was compared with.
///
/// Works on any triangle soup: boundaries, non-manifold edges and vertices, several materials,
/// several texture coordinates per vertex, faces without any. Output vertices are input vertices.
/// The quadrics are those of the faces, weighted by area, computed once on the centred mesh scaled
/// to a unit diagonal, and accumulated. A collapse v -> t costs (Q_v + Q_t)(t). The cheapest legal
/// collapse is made next; ties go to the shorter edge, then to the lower indices. No collapse turns
/// a face over, in space or (with a texture term) in texture space, or makes a degenerate or
/// duplicate face. The error of a collapse is sqrt(surface quadric / its weight). It measures the
/// distance to the planes of the faces and is no bound of the Hausdorff distance. Deterministic.
/// O(E log E) time, O(V + F) memory, one thread.
/// @throws InputError  as check_mesh(); a bounding box without a finite diagonal; an option out of
///                     range.
QemResult simplify_qem(const MeshView& mesh, const QemOptions& options,
                       const Progress& progress = {});

/// Return the mesh after the first collapses of a record, until it has `target_faces` or fewer.
/// Its mesh, maps, collapses and max_error equal those of simplify_qem() for that target;
/// `rejected`, `distance_bound` and the reason for stopping short of the target are not part of the
/// record. O(V + F).
/// @throws InputError  the record does not belong to the mesh.
QemResult replay_collapses(const MeshView& mesh, const QemOptions& options,
                           const std::vector<Collapse>& collapses, std::int64_t target_faces,
                           const Progress& progress = {});

/// Curvature of a boundary curve at `vertex` from its two boundary neighbours (eq. 2.5), clamped to
/// [0, 10]; 10 if the neighbours coincide.
/// @param diagonal  Diagonal of the mesh's bounding box, the unit of kPaper.
double boundary_curvature(const Eigen::Vector3d& previous, const Eigen::Vector3d& vertex,
                          const Eigen::Vector3d& next, BoundaryCurvature kind, double diagonal);

}  // namespace manip3d
