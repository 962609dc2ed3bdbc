#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/grid_mesh.hpp"
#include "manip3d/progress.hpp"
#include "manip3d/simplify/depth_coverage.hpp"

namespace manip3d {

/// Limit of the time that a relief takes. Each effort is slower and nearer to the surface than the
/// one before, except that kLive is about as near as kFast.
enum class ReliefEffort : std::uint8_t { kLive, kFast, kBalanced, kFine, kBest };

struct ReliefOptions {
  std::int64_t target_points = 0;  ///< Largest number of vertices; at least 3.
  ReliefEffort effort = ReliefEffort::kBalanced;
  /// Let vertices leave the measured points along their lines of sight, where that lowers the
  /// error.
  bool move_points = false;
  /// Whether the points were measured by a camera at the origin, through which all lines of sight
  /// pass. If not, lines of sight are parallel to the mean normal of the surface.
  bool from_origin = false;
  DenseRule dense;
  /// Factor on the cost of giving up a pixel that was a vertex in the previous frame; 1: frames are
  /// independent. Above 1, edges of the previous frame stay as well unless others halve the error.
  /// Only for frames of one size through one object.
  double stability = 1.0;
  /// Sizes of smaller meshes that share the vertices: strictly decreasing, at least 3, below
  /// target_points; not with move_points. Each mesh uses the first vertices.
  std::vector<std::int64_t> levels;
  /// Compute ReliefResult::cover and cover_without_off, as depth_coverage() would.
  bool measure_coverage = true;
  int num_threads = 0;  ///< 0: all cores.
};

/// Reason why the relief has its number of vertices.
enum class ReliefStop : std::uint8_t {
  kTarget,       ///< The mesh was reduced to the target.
  kAllPoints,    ///< The surface has at most target_points points.
  kSmallPieces,  ///< Small pieces were left out (dropped_pixels), each with all of its vertices.
  /// A few triangles of a larger mesh are the result; the others were left out (dropped_pixels).
  kFewFaces,
  kFewerPoints,  ///< A mesh of fewer vertices covers more; it may be without small pieces as well.
  /// Vertices at pinholes merged into others, or were left out with their triangles.
  kPinholes,
  /// No legal collapse kept the vertices of a smaller level; the result is its mesh.
  kSmallerLevel
};

/// A mesh over the first vertices of a larger one.
struct ReliefLevel {
  std::int64_t num_vertices = 0;
  Rows<std::int32_t, 3> faces;
};

struct ReliefResult {
  DepthMesh mesh;
  std::vector<ReliefLevel> levels;  ///< Sizes as in ReliefOptions::levels, or less.
  ReliefStop stop = ReliefStop::kTarget;
  /// Pixels of the pieces or, with kFewFaces, triangles left out, except triangles at pinholes.
  std::int64_t dropped_pixels = 0;
  /// (k, 2) column and row of the pixels of pinholes over which the surface was continued.
  Rows<std::int32_t, 2> filled;
  /// (k, 2) column and row of the measured pixels that were left out as pieces without confidence.
  Rows<std::int32_t, 2> unsure;
  /// Coverage of the mesh before points move; 0 if it was not measured.
  DepthCoverage cover;
  /// By face, with a limit on steps: 1 if the face joins surfaces that a step separates: steps make
  /// up most of the difference in depth along one of its sides, and faces_off_surface() is above a
  /// quarter or negative. Empty without a limit.
  std::vector<std::uint8_t> off;
  DepthCoverage cover_without_off;  ///< `cover` without these faces.
  /// With move_points: mean distance that vertices moved, in units of the points.
  double mean_move = 0.0;
  double max_move = 0.0;  ///< Largest such distance.
};

/// Approximate the dense surface of a point grid (that of grid_mesh()) with few vertices, so that
/// the mean distance from the surface to the mesh is small.
///
/// 0. Pinholes. Holes of up to four pixels within one surface are not ends of the surface; neither
///    is a measurement with steps all around it, which counts as such a hole. The surface is
///    continued over them with confidence 0, unless they are fewer than one pixel in a thousand, or
///    the target has room for all pixels. Pixels are missing by chance if a fiftieth of all, and at
///    least 50, are amid a surface, away from squares of five pixels a side without a measurement.
///    Then all these pixels are treated alike, in holes of any size. Without limits on edges and
///    steps, only lone pixels count towards the fiftieth, because nothing tells whether a narrow
///    gap is within a surface. In the result no vertex is at such a pixel.
/// 1. First triangulation: adaptive, by longest-edge bisection, down to single pixels where the
///    surface ends or is cut, so that silhouettes and depth discontinuities are boundaries of the
///    mesh from the start. kLive bisects by distance times area, and not below squares of four
///    pixels at the ends of the surface: there, each pixel at which the contour turns is a vertex,
///    and the rest of the square has few others.
/// 2. Simplification. Edges collapse onto one of their ends, at a price of the growth of sqrt(area
///    x quadric). This estimates area times distance, which the mean distance measures, whereas
///    quadrics alone [Garland & Heckbert 1997] measure squared distances. Three more operations are
///    used where they cost less than the next collapse, so that any target is reached: holes of
///    three vertices are closed, bays without surface are filled, and pieces of one triangle are
///    left out. Boundary vertices and pieces that cover more pixels per vertex than the mesh will
///    have on average go last, so that near objects, whose area is small, are kept. Vertices on the
///    boundary then move pixel by pixel to the ends of the surface. kLive makes most collapses in
///    the order of the vertices, below a price limit that increases from pass to pass. If pieces of
///    fewer than one pixel in a thousand would have a tenth of the vertices, those below the limit
///    are left out in these passes too.
///    With a limit on steps and at most 64 points, two more meshes are made: one without triangles
///    across a step, and one of those triangles of a finer mesh that cover most. The result is the
///    mesh that covers most. With 65 to 128 points, the meshes of 64 are made as well, and one is
///    the result if it covers 1.1 times as much. With at most 64 points, if the mesh of kLive
///    covers less than half, that of kFast is made too, under the same condition. If pieces of
///    fewer than one pixel in a thousand are a tenth of the area, as with depths that are far off,
///    a mesh without them is made as well; it is the result if it covers 1.1 times as much. Without
///    `levels`, a surface always keeps at least one triangle.
/// 3. Refinement. Edges are flipped, and vertices moved to measured points nearby, while that
///    lowers the sum of distances between the pixels and the planes of their triangles [cf. Dyn,
///    Levin & Rippa 1990, data dependent triangulations]. kLive evaluates flips at twelve pixels of
///    each pair of triangles. Vertices never cross ends or steps of the surface. If there are at
///    least 32 pixels for each vertex, kBalanced and slower efforts then merge vertices that save
///    little and add as many to the boundary where they cover more. Finally a triangle
///    is left out if more of its area lies over pixels without surface than it alone covers of the
///    surface, both as shares of the whole; kLive has no time for that.
/// 4. With `move_points`, vertices slide along their lines of sight towards the least-squares fit
///    of all pixels: the whole way, half of it or not at all, whichever leaves the least error
///    around them.
/// 5. With `levels`, each size is made by steps 1 to 3, the smallest first, and keeps the vertices
///    of the previous size, which gives a progressive order of the vertices. If these vertices
///    leave no legal collapse to a size, its mesh is that of the previous size. If two fans of a
///    smaller size meet at a pixel at which the larger size has one vertex, they share it.
///
/// The confidence of a pixel is a factor on each of these measures: on the error of a pixel that is
/// bisected or covered by a triangle, and on the area of a triangle in step 2, where the factor is
/// the smaller of the least confidence of its corners and the mean confidence of its other pixels.
/// Lost surface counts with at least a twentieth of the mean confidence. Closing holes and filling
/// bays does not depend on confidences, because nothing was measured there. A piece of the surface
/// whose mean confidence is below a thousandth of the whole's counts as not measured
/// (ReliefResult::unsure). Pixels of less confidence than that have none. Step 2 begins with the
/// vertices within the surface at such pixels, for which step 1 makes room: they move to the
/// nearest other pixel of their triangles, or merge into others around them. Losing surface,
/// closing holes and filling bays between three such pixels counts a thousandth, because noise
/// makes holes and steps there. Where a vertex has such pixels and others around it, the price of a
/// collapse is at least the growth of the error of its pixels, and step 3 flips edges until nothing
/// changes.
///
/// Keeps its memory between frames of the same size. The result depends only on the input.
class Relief {
 public:
  Relief();
  ~Relief();
  Relief(Relief&&) noexcept;
  Relief& operator=(Relief&&) noexcept;

  /// Overwrites `result`, reusing its memory.
  /// @param confidence  By pixel, 0 to 1: factor on the distance of the pixel from the mesh, in
  ///                    addition to its area. May be empty; then all are 1. A pixel of confidence 0
  ///                    is still surface that should be covered, except in pieces of such pixels.
  /// @param progress    May throw to cancel the run; the previous frame is forgotten then. It is
  ///                    called with the fraction 0, because the remaining time is unknown.
  /// @throws InputError  as check_point_grid; target_points < 3; DenseRule::check(); stability < 1;
  ///                     levels as above; num_threads < 0; numbers of confidences and pixels
  ///                     differ; a confidence that is not 0 to 1.
  void run(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result,
           std::span<const float> confidence = {}, const Progress& progress = {});

  /// Overload for a depth image. The memory of its points is reused as well.
  /// @throws InputError  also as unproject().
  void run(const DepthView& depth, const PixelRays& rays, const ReliefOptions& options,
           ReliefResult& result, std::span<const float> confidence = {},
           const Progress& progress = {});

  /// Forgets the previous frame.
  void reset();

 private:
  struct Memory;
  std::unique_ptr<Memory> memory_;
};

/// The relief of a single frame.
ReliefResult relief(const PointGridView& grid, const ReliefOptions& options,
                    std::span<const float> confidence = {});

}  // namespace manip3d
