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

/// How much time a relief may take. Each effort is slower and nearer to the surface than the one
/// before, except that kLive is about as near as kFast.
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

/// How the number of vertices was reached.
enum class ReliefStop : std::uint8_t {
  kTarget,     ///< The mesh was reduced to the target.
  kAllPoints,  ///< The surface has at most target_points points.
  /// Pieces were left out: small ones, triangles at a pinhole whose vertex could not be removed,
  /// or, if nothing else was possible, all but a few triangles.
  kSmallPieces,
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
  std::int64_t dropped_pixels = 0;  ///< For kSmallPieces: pixels of the pieces left out.
  std::int64_t filled_pixels = 0;   ///< Pixels of pinholes over which the surface was continued.
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
/// 0. Holes of up to four pixels amid one surface are not ends of it, and a measurement with steps
///    all around it is such a hole: the surface is continued over them, with confidence 0, unless
///    they are fewer than one pixel of a thousand, or the target leaves room for all pixels. Where
///    they are one of fifty, pixels are missing at random, and holes of up to 32 pixels are treated
///    alike. No vertex is there in the end.
/// 1. An adaptive triangulation by longest-edge bisection, down to single pixels where the surface
///    ends or is cut: silhouettes and depth discontinuities are boundaries of the mesh from the
///    start. kLive bisects by distance times area, and not below squares of four pixels where the
///    surface ends: there a contour has a vertex at each pixel at which it turns, and what is left
///    of the square few others.
/// 2. Holes down to three vertices are closed, bays of pixels without surface filled and pieces
///    down to one triangle left out where that costs less than the next collapse, so that any
///    target is met. With 64 points or fewer, and steps, two more meshes are made: one without
///    triangles that a step keeps apart, and some triangles of a finer mesh, those that cover most;
///    the one that covers most is the result. Where pieces of fewer than one pixel of a thousand
///    are a tenth of the area, as depths that are far off, a mesh without them is made as well, and
///    is the result if it covers 1.1 times as much. Without `levels` a surface always keeps a
///    triangle.
///    Edges collapse onto one of their ends, priced by how much sqrt(area x quadric) grows: an
///    estimate of area times distance, what the mean measures, where quadrics alone [Garland &
///    Heckbert 1997] measure squares. Vertices on the boundary then move pixel by pixel to where
///    the surface ends. kLive does all but that with every second pixel, where there are 64 or more
///    to a vertex, and most collapses in the order of the vertices, below a limit for the price
///    that rises from pass to pass.
/// 3. Edges are flipped and vertices moved to other measured points nearby while that lowers the
///    sum of distances between the pixels and the planes of their triangles [cf. Dyn, Levin &
///    Rippa 1990, data dependent triangulations]. kLive flips by twelve pixels of each pair of
///    triangles. Vertices stay on their side of the ends and steps of the surface. At last
///    triangles are left out of which more area lies over pixels without surface than they alone
///    cover of it, as shares of the whole; kLive has no time for that.
/// 4. `move_points`: vertices slide along their lines of sight towards the least-squares fit of all
///    pixels, all the way, half of it or not at all: what leaves the least error around them.
/// 5. `levels`: each size is made by steps 1 to 3, the smallest first, and the vertices of the size
///    before stay: a progressive order of the vertices. Where they leave no legal way to a size,
///    its mesh is that of the size before. Two fans of a smaller size that meet at a pixel share
///    its vertex where the larger size has only one there.
///
/// The confidence of a pixel multiplies each of these measures: the error of a pixel that is
/// halved or of the pixels that a triangle lies over, and the area of a triangle of step 2, which
/// counts by the least of its corners' confidences and of the mean of the other pixels in it. What
/// is lost counts no less than a twentieth of the mean confidence. Only
/// what closes holes and fills bays does not depend on it: nothing was measured there.
///
/// Keeps its memory between frames of the same size. The result depends on the input alone.
class Relief {
 public:
  Relief();
  ~Relief();
  Relief(Relief&&) noexcept;
  Relief& operator=(Relief&&) noexcept;

  /// Overwrites `result`, reusing its memory.
  /// @param confidence  by pixel, 0 to 1: how much its distance from the mesh counts, beside its
  ///                    area; may be empty: all are 1. What a pixel of confidence 0 shows is still
  ///                    a surface that is to be covered.
  /// @param progress    may throw to cancel the run; the frame before is then forgotten. It is told
  ///                    the fraction 0: how long the rest takes is not known.
  /// @throws InputError  as check_point_grid; target_points < 3; DenseRule::check();
  ///                     stability < 1; levels as above; num_threads < 0; another number of
  ///                     confidences than of pixels, or one that is not 0 to 1.
  void run(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result,
           std::span<const float> confidence = {}, const Progress& progress = {});

  /// Overload for a depth image, whose points are kept in memory that is reused, too.
  /// @throws InputError  also as unproject().
  void run(const DepthView& depth, const PixelRays& rays, const ReliefOptions& options,
           ReliefResult& result, std::span<const float> confidence = {},
           const Progress& progress = {});

  /// Forgets the frame before.
  void reset();

 private:
  struct Memory;
  std::unique_ptr<Memory> memory_;
};

/// The relief of a single frame.
ReliefResult relief(const PointGridView& grid, const ReliefOptions& options,
                    std::span<const float> confidence = {});

/// Flips edges of triangles over pixels of a grid as step 3 does, of kBalanced: where that lowers
/// the sum of distances between the pixels and the planes of their triangles. The dense surface is
/// that of all valid pixels.
/// @param pixels  (n, 2) column and row of each vertex, each pixel once.
/// @param faces   (m, 3) a surface in the pixel plane: front faces look at the sensor, and on each
///                side of an edge there is at most one.
/// @throws InputError  as Relief::run; a pixel or an index out of range, a pixel that is not valid,
///                     or faces that turn the other way or share a side of an edge.
Rows<std::int32_t, 3> flip_edges(const PointGridView& grid,
                                 const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                 const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                 std::span<const float> confidence = {});

}  // namespace manip3d
