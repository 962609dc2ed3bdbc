#include "manip3d/simplify/relief.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <compare>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "simplify/relief_boundary.hpp"
#include "simplify/relief_collapse.hpp"
#include "simplify/relief_coverage.hpp"
#include "simplify/relief_pinholes.hpp"
#include "simplify/relief_refine.hpp"
#include "simplify/relief_start.hpp"
#include "simplify/relief_surface.hpp"
#include "simplify/relief_triangulation.hpp"

namespace manip3d {
namespace {

using relief_detail::CutCoverage;
using relief_detail::EdgeMemory;
using relief_detail::Keep;
using relief_detail::kMissingFactor;
using relief_detail::OffFaces;
using relief_detail::Surface;
using relief_detail::Triangle;
using relief_detail::Triangulation;
using relief_detail::Vec3;

/// Pixels per vertex from which on a first mesh over every second pixel is as good: at 1 % of the
/// points the result was the same on three of four images and scans, its error 1.01 times on the
/// fourth.
constexpr std::int64_t kSparse = 32;

/// Pixels per vertex from which on every second pixel is enough for an effort that takes a share of
/// the time.
constexpr std::int64_t kHalf = 64;

/// Used pixels below which that effort has time for more: it triangulates all pixels where there
/// are more than kWhole for each vertex, and more vertices than kFew, and leaves out bridges. On 35
/// such scans and people the error at 0.5 % of the points is 0.98 times as large, at most 1.3
/// instead of 1.64 times an edge collapse's, in 1.1 to 1.2 times the time.
constexpr std::int64_t kSmall = 50'000;
constexpr std::int64_t kWhole = 128;

/// Pixels per vertex down to which contours are triangulated square by square: with fewer, pixels
/// amid the squares are wanted as well.
constexpr std::int64_t kDense = 6;

/// How many times as much false surface costs as missing one, where pixels are missing at random.
/// Tried on four draws of 30 % of a made-up surface: of 0.3, 1, 2, 3 and 10, 2 and 3 cover most.
constexpr float kChanceFalse = 3.0F;

/// Pixels at the ends of the surface for each vertex of the target, from which on a mesh has much
/// contour, and how many times as much missing surface costs there, down to kSparse pixels per
/// vertex. Of 1, 3, 4 and 6 times, tried on every second scan and recording of the data folder at
/// 5 %, 4 is the least that covers 0.99 of all; the error stays below 0.91 of an edge collapse's.
constexpr double kMuchContour = 1.5;
constexpr float kContourPrice = 4.0F;

/// A surface of every second pixel that lacks more of the dense triangles than this, or of their
/// area, is too thin. A strip far away may be a row of pixels and most of the area.
constexpr double kThin = 0.1;

/// How many times as much is covered where triangles of a finer mesh are better than the whole of a
/// coarse one: what they leave out is left out altogether, and the mean distance counts it most.
/// It also holds for a mesh of fewer vertices than allowed: of ten that covered more, the three
/// beyond this factor had 0.66 to 1.01 times the error, the others up to 1.65 times.
constexpr double kWorthLeaving = 1.1;

/// Sizes of which the next smaller kFewTries are tried in place of a few vertices. Of 756 budgets
/// of scans and frames of the data folder, 49 covered by kWorthLeaving less than a smaller one of
/// these sizes; with three tries 3 do.
constexpr int kFewTries = 3;
constexpr std::array<std::int64_t, 15> kFewSizes = {3,  4,  5,  6,  7,  8,  10, 12,
                                                    14, 16, 20, 25, 30, 40, 50};

/// A piece of fewer than one pixel of so many is a speck.
constexpr std::int64_t kSpeck = 1000;

/// Specks of more than this share of the area take so many of many vertices, or of those of an
/// effort without time, that a mesh without them is made as well.
constexpr double kMuchSpeck = 0.1;

/// The work that an effort does. Measured on the Stanford scans; each step pays for itself.
struct Budget {
  /// Bisections of the first triangulation per target point. Of 1, 2, 2.5 and 3 for kBalanced,
  /// tried on six rendered shelves at 5 % of the points, 2.5 leaves at most 1.2 times the error of
  /// an edge collapse, 2 and 1 leave up to 1.6 and 2.4 times.
  double start;
  int finest;         ///< Pixels between its inner vertices, from kSparse on.
  float round_share;  ///< Share of the vertices that a round may remove.
  int flip_sweeps;
  float flip_floor;  ///< Pairs of triangles below this many mean errors are not looked at.
  bool by_sample;    ///< Refiner::flip_sampled(): `flip_floor` counts mean volumes.
  int move_rounds;   ///< Rounds of moves and flips.
  int radius;        ///< Farthest move, pixels.
  int boundary_sweeps;
  /// If positive: from kHalf on every second pixel is triangulated, with so many bisections.
  double half_start;
  bool by_tile;    ///< The first triangulation is ordered tile by tile.
  bool by_blocks;  ///< Ends of the surface are triangulated by ContourBlocks.
  /// If positive: Collapser::sweep() first. Of 0.4, 0.6 and 0.9, tried on two scenes and a scan,
  /// 0.9 takes 0.4 to 0.7 of the time of collapses in order of price, at no more error.
  float sweep_share;
  /// Bisections per target point for each share of the pixels that the target is, where that is
  /// more than `start`: collapses choose better than bisections, and had little left to choose. Of
  /// 14, 16 and 20 for kFast, tried on two scenes, two scans and a person, 14 is enough for 1.2
  /// times the error of an edge collapse at 5, 10 and 20 % of the points (1.3, 2.3 and 2.0
  /// without). With 18 it stays nearer to the surface than kLive did on four of these. Of 8, 11,
  /// 14, 16 and 18 for kLive, tried on three scenes and two scans at 5 %, 16 is enough for 1.3
  /// times.
  double dense_start;
  /// Collapser's factor on the price of missing surface, down to kSparse pixels per vertex; beyond,
  /// it is kMissingFactor. Of 12, 16 and 20, tried for kLive on three scenes and two
  /// scans, 20 covers 0.001 to 0.002 more at 5 % than 12, at the same error. At 1 % it costs scans
  /// from the side up to a quarter of their error.
  float missing;
};

Budget budget_of(ReliefEffort effort, std::int64_t target) {
  switch (effort) {
    case ReliefEffort::kLive:
      return {0.4, 2, 0.4F, 2, 0.1F, true, 0, 0, 2, 2.0, true, true, 0.9F, 16.0, 20.0F};
    case ReliefEffort::kFast:
      return {0.7, 1, 0.3F, 3, 0.3F, false, 0, 0, 4, 0.0, false, false, 0.0F, 18.0, kMissingFactor};
    case ReliefEffort::kBalanced:
      // Few vertices have few choices: those of larger rounds and finer meshes cost up to 1.6 times
      // the error there.
      if (target <= relief_detail::kFew) {
        return {1.0, 1,     0.2F,  3,    0.3F, false,         1, 1, 4,
                0.0, false, false, 0.0F, 0.0,  kMissingFactor};
      }
      return {2.5, 1, 0.3F, 3, 0.3F, false, 1, 1, 4, 0.0, false, false, 0.0F, 0.0, kMissingFactor};
    case ReliefEffort::kFine:
      return {3.0, 1, 0.2F, 4, 0.3F, false, 2, 1, 4, 0.0, false, false, 0.0F, 0.0, kMissingFactor};
    case ReliefEffort::kBest:
      break;
  }
  return {1e9, 1, 0.1F, 8, 0.3F, false, 4, 2, 4, 0.0, false, false, 0.0F, 0.0, kMissingFactor};
}

void check_options(const ReliefOptions& options) {
  if (options.target_points < 3) {
    throw InputError("target_points: expected at least 3, got " +
                     std::to_string(options.target_points));
  }
  if (!(options.stability >= 1.0)) {
    throw InputError("stability: expected at least 1, got " + std::to_string(options.stability));
  }
  options.dense.check();
  std::int64_t larger = options.target_points;
  for (const std::int64_t size : options.levels) {
    if (size < 3 || size >= larger) {
      throw InputError("levels: expected sizes of at least 3, strictly decreasing from " +
                       std::to_string(options.target_points) + ", got " + std::to_string(size));
    }
    larger = size;
  }
  if (options.move_points && !options.levels.empty()) {
    throw InputError("levels: expected none with move_points, got " +
                     std::to_string(options.levels.size()));
  }
}

void check_confidence(const PointGridView& grid, std::span<const float> confidence) {
  const auto num_pixels = static_cast<std::size_t>(grid.rows * grid.cols);
  if (!confidence.empty() && confidence.size() != num_pixels) {
    throw InputError("confidence: expected " + std::to_string(num_pixels) + " numbers, got " +
                     std::to_string(confidence.size()));
  }
  for (const float share : confidence) {
    if (!(share >= 0.0F && share <= 1.0F)) {
      throw InputError("confidence: expected 0 to 1, got " + std::to_string(share));
    }
  }
}

std::vector<Triangle> triangles_of(const Surface& surface, const PointGridView& grid,
                                   const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                   const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                   std::vector<std::int32_t>& vertex_at) {
  std::vector<std::int32_t> at(pixels.rows());
  vertex_at.assign(surface.num_pixels(), Triangulation::kNone);
  for (Eigen::Index i = 0; i < pixels.rows(); ++i) {
    const std::int64_t u = pixels(i, 0), v = pixels(i, 1);
    if (u < 0 || v < 0 || u >= grid.cols || v >= grid.rows || grid.valid[v * grid.cols + u] == 0) {
      throw InputError("pixels: expected valid pixels of the grid, got (" + std::to_string(u) +
                       ", " + std::to_string(v) + ")");
    }
    at[i] = static_cast<std::int32_t>((v - surface.input_v(0)) * surface.cols() + u -
                                      surface.input_u(0));
    if (vertex_at[at[i]] != Triangulation::kNone) {
      throw InputError("pixels: expected each pixel once, got (" + std::to_string(u) + ", " +
                       std::to_string(v) + ") again");
    }
    vertex_at[at[i]] = static_cast<std::int32_t>(i);
  }
  std::vector<Triangle> triangles;
  std::vector<std::uint64_t> sides;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    Triangle t{};
    for (int i = 0; i < 3; ++i) {
      const std::int32_t vertex = faces(f, i);
      if (vertex < 0 || vertex >= pixels.rows()) {
        throw InputError("faces: index out of range: " + std::to_string(vertex));
      }
      t[i] = at[vertex];
    }
    if (!grid.rows_up) std::swap(t[1], t[2]);
    const std::int64_t du1 = surface.u(t[1]) - surface.u(t[0]);
    const std::int64_t dv1 = surface.v(t[1]) - surface.v(t[0]);
    const std::int64_t du2 = surface.u(t[2]) - surface.u(t[0]);
    const std::int64_t dv2 = surface.v(t[2]) - surface.v(t[0]);
    if (du1 * dv2 - dv1 * du2 <= 0) {
      throw InputError("faces: expected front faces that look at the sensor, got face " +
                       std::to_string(f));
    }
    for (int i = 0; i < 3; ++i) {
      sides.push_back(static_cast<std::uint64_t>(t[i]) << 32 |
                      static_cast<std::uint64_t>(t[(i + 1) % 3]));
    }
    triangles.push_back(t);
  }
  std::sort(sides.begin(), sides.end());
  if (std::adjacent_find(sides.begin(), sides.end()) != sides.end()) {
    throw InputError("faces: expected at most one face on each side of an edge, got more");
  }
  return triangles;
}

}  // namespace

struct Relief::Memory {
  PointGrid points;  ///< Points of the depth image, if one was given.
  relief_detail::PinholeFiller pinholes;
  Surface surface;
  Surface measured;  ///< `surface` without what lies over pinholes, if there are any.
  Surface half;      ///< Every second pixel of `surface`.
  const Surface* worked = &surface;  ///< The surface that is triangulated: `surface` or `half`.
  relief_detail::BoundaryMover boundary;
  relief_detail::StartMesh start;
  Triangulation mesh;
  Triangulation best;  ///< The best of those that were made before.
  relief_detail::Collapser collapser;
  relief_detail::Refiner refiner;
  std::vector<Vec3> sight;            ///< By vertex: where it may slide.
  std::vector<std::int32_t> order;    ///< Vertices by pixel.
  std::vector<std::int32_t> sorting;  ///< Scratch of what sorts them.
  std::vector<std::int32_t> number;   ///< Vertex -> output vertex; kNone: left out.
  enum class Written : std::uint8_t {
    kNot,
    kAsOwn,     ///< A vertex of its own.
    kWithLast,  ///< The vertex of the fan before it at its pixel.
  };
  /// By level, last the mesh, and vertex; empty: all as their own.
  std::vector<std::vector<Written>> written;
  std::vector<std::uint8_t> may_write;       ///< By vertex.
  std::vector<std::int32_t> written_pixels;  ///< Pixels of the vertices that are written.
  struct Placed {
    std::int32_t pixel, number;
    auto operator<=>(const Placed&) const = default;
  };
  std::vector<Placed> placed;          ///< Output vertices by pixel.
  std::vector<std::int64_t> previous;  ///< Input pixels of the frame before.
  EdgeMemory before;                   ///< Edges of the frame before.
  relief_detail::CoverageScratch coverage;
  std::vector<Keep> keep;             ///< By pixel of the surface; or empty.
  std::vector<Triangulation> levels;  ///< The smaller meshes, smallest first.
  double speck_area = 0.0;            ///< Share of the area of the small pieces of select().
  bool leaves_specks = false;         ///< It leaves them out first.
  Progress progress;                  ///< The run asks it whether it is cancelled.
  std::vector<Triangle> dense;        ///< All of them, where the target leaves room for all pixels.

  [[nodiscard]] bool takes_all(const ReliefOptions& options) const {
    const std::int64_t least =
        options.levels.empty() ? options.target_points : options.levels.back();
    return surface.num_used() <= least;
  }
  /// Takes the dense surface of a grid, continued over its pinholes unless the target leaves room
  /// for all pixels; the grid that it is of.
  PointGridView take_surface(const PointGridView& grid, const ReliefOptions& options,
                             std::span<const float> confidence);
  /// Moves vertices from filled pixels to measured ones.
  void leave_pinholes();
  [[nodiscard]] bool is_pinhole(std::int32_t pixel) const {
    return pinholes.num_filled() > 0 &&
           pinholes.is_filled(surface.input_v(pixel) * pinholes.grid().cols +
                              surface.input_u(pixel));
  }
  /// Points `worked` to the surface that is good enough for the target.
  void choose_surface(ReliefEffort effort, std::int64_t target);
  /// Moves the mesh to the whole surface, and its boundary to where that ends.
  void move_boundary(const ReliefOptions& options, std::int64_t target);
  /// Fills `keep` with the vertices of the frame before.
  void recall(const PointGridView& grid, const ReliefOptions& options);
  /// Does the first triangulation have more contour than so many vertices can follow?
  [[nodiscard]] bool has_much_contour(std::int64_t target) const;
  /// Triangulates and collapses edges until the mesh has at most `target` vertices.
  void select(const ReliefOptions& options, std::int64_t target, OffFaces off,
              ReliefResult& result);
  /// Steps 1 to 3 of the operator for one size.
  void make_mesh(const ReliefOptions& options, std::int64_t target, OffFaces off,
                 ReliefResult& result);
  double written_coverage(const Triangulation& of);
  void try_mesh(const ReliefOptions& options, std::int64_t target, OffFaces off, double factor,
                double& covered, ReliefResult& result);
  void make_best_mesh(const ReliefOptions& options, std::int64_t target, ReliefResult& result);
  /// Flips edges and moves vertices.
  void refine(const Budget& budget);
  /// The surface without what lies over pinholes.
  [[nodiscard]] const Surface& seen() const {
    return pinholes.num_filled() > 0 ? measured : surface;
  }
  [[nodiscard]] bool is_written(const Triangulation& of, std::int32_t t) const;
  void keep_a_face(ReliefResult& result);
  void build_meshes(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
  void take_all(ReliefResult& result);
  void run(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result,
           std::span<const float> confidence);
  void fix_vertices();
  [[nodiscard]] bool holds(const Triangulation& smaller);
  void find_sight(const ReliefOptions& options);
  /// Which vertices of the mesh and of its levels are written. A vertex that could not leave a
  /// pinhole goes, with its triangles, and vertices that are left without a triangle go, too. From
  /// the largest size down, since each has the vertices of the next smaller one: two fans that meet
  /// at a pixel share the vertex of one fan that the larger size has there.
  /// @param once  the triangles of a pixel share a vertex, also where they meet nowhere else.
  void find_written(bool once);
  [[nodiscard]] bool has_many_pixels() const {
    return static_cast<std::int64_t>(surface.num_pixels()) > relief_detail::kManyPixels;
  }
  /// Gives back what is of no more use when the result is written.
  void release_meshes();
  /// Lets the run be cancelled between two stages.
  void check_cancelled() const {
    if (progress) progress(0.0);
  }
  void find_written(const Triangulation& of, std::vector<Written>& how);
  std::int32_t number_vertices(const Triangulation& of, std::span<const Written> how);
  void write(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
  void write_faces(const Triangulation& from, bool rows_up, Rows<std::int32_t, 3>& to);
  void leave_bridges(const ReliefOptions& options, ReliefResult& result);
  void move_points(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
};

PointGridView Relief::Memory::take_surface(const PointGridView& grid, const ReliefOptions& options,
                                           std::span<const float> confidence) {
  surface.assign(grid, options.dense, confidence, options.num_threads);
  pinholes.clear();
  if (surface.empty() || takes_all(options)) return grid;
  check_cancelled();
  if (!pinholes.fill(grid, options.dense, confidence, surface)) return grid;
  std::swap(surface, measured);
  check_cancelled();
  const PointGridView filled = pinholes.grid();
  // Building everything anew is quicker where many pixels are missing.
  if (pinholes.are_by_chance() ||
      !surface.assign_filled(measured, filled, options.dense, pinholes.confidence(),
                             pinholes.filled())) {
    surface.assign(filled, options.dense, pinholes.confidence(), options.num_threads);
  }
  return filled;
}

void Relief::Memory::leave_pinholes() {
  if (pinholes.num_filled() == 0) return;
  const std::span<const Keep> kept = worked == &surface ? keep : std::span<const Keep>();
  refiner.leave_pixels(surface, mesh, kept,
                       [this](std::int32_t pixel) { return is_pinhole(pixel); });
}

/// Every second pixel is a quarter of the work. Of 0.4, 1, 2 and 4 bisections per target point, 2
/// leaves less error than all pixels did on four of five images at 1 % of the points, in no more
/// time.
void Relief::Memory::choose_surface(ReliefEffort effort, std::int64_t target) {
  worked = &surface;
  const std::int64_t used = surface.num_used();
  if (budget_of(effort, target).half_start == 0.0 || target > used / kHalf) return;
  if (used < kSmall && target > relief_detail::kFew && target < used / kWhole) return;
  if (!levels.empty()) return;  // theirs may be between
  half.assign_half(surface);
  const auto below = 4.0 * static_cast<double>(half.num_faces());
  if (below < (1.0 - kThin) * static_cast<double>(surface.num_faces())) return;
  const double here = double{half.mean_area()} * static_cast<double>(half.num_used());
  const double not_here = half.area_not_here(surface);
  if (not_here <= kThin * (here + not_here)) worked = &half;
}

void Relief::Memory::move_boundary(const ReliefOptions& options, std::int64_t target) {
  if (worked != &surface) mesh.change_surface(half, surface);
  // Vertices of the frame before stay: they were moved then. With every second pixel it is not
  // known which vertices those are.
  const std::span<const Keep> kept = worked == &surface ? keep : std::span<const Keep>();
  // kLive has no time to ask for the price; of few vertices each one should cover much.
  const bool at_any_price = options.effort == ReliefEffort::kLive || target <= relief_detail::kFew;
  boundary.run(surface, mesh, kept, budget_of(options.effort, target).boundary_sweeps, at_any_price,
               progress);
}

void Relief::Memory::recall(const PointGridView& grid, const ReliefOptions& options) {
  keep.clear();
  if (!(options.stability > 1.0)) before.clear();
  if (!(options.stability > 1.0) || previous.empty()) return;
  keep.assign(worked->num_pixels(), Keep::kFree);
  for (const std::int64_t pixel : previous) {
    const std::int32_t at = worked->pixel_at(pixel % grid.cols, pixel / grid.cols);
    if (at >= 0 && worked->is_used(at)) keep[at] = Keep::kPrefer;
  }
}

bool Relief::Memory::has_much_contour(std::int64_t target) const {
  std::int64_t ends = 0;
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    ends += mesh.vertex(v).alive() && mesh.vertex(v).on_boundary ? 1 : 0;
  }
  return static_cast<double>(ends) > kMuchContour * static_cast<double>(target);
}

void Relief::Memory::select(const ReliefOptions& options, std::int64_t target, OffFaces off,
                            ReliefResult& result) {
  const Budget budget = budget_of(options.effort, target);
  const std::int64_t used = worked->num_used();
  const double share =
      worked == &surface ? std::max(budget.start, budget.dense_start * static_cast<double>(target) /
                                                      static_cast<double>(used))
                         : budget.half_start;
  const double wanted = share * static_cast<double>(target);
  auto splits = static_cast<std::int64_t>(std::min(wanted, static_cast<double>(used)));
  const bool is_sparse = worked != &surface || target <= used / kSparse;
  int finest = worked == &surface && is_sparse ? budget.finest : 1;
  result.stop = used <= target ? ReliefStop::kAllPoints : ReliefStop::kTarget;
  result.dropped_pixels = 0;
  speck_area = 0.0;
  if (used <= target) splits = used, finest = 1;
  bool by_blocks = budget.by_blocks && kDense * target < used;
  const auto triangulate = [&] {
    const std::span<const Triangle> faces =
        start.build(*worked, splits, finest, keep, by_blocks, progress);
    check_cancelled();
    mesh.assign(*worked, budget.by_tile ? start.order_by_tile(*worked) : faces);
  };
  triangulate();
  while (mesh.num_vertices() < target && (splits < used || finest > 1 || by_blocks)) {
    if (splits == used) by_blocks = false;  // squares that are cut leave pixels out
    splits = std::min(2 * splits, used);
    if (splits == used) finest = 1;
    triangulate();
  }
  if (has_many_pixels()) {
    start = {};
    mesh.release_scratch();
  }
  if (mesh.num_vertices() <= target) return;
  check_cancelled();
  const std::int64_t area = worked == &surface ? 1 : 4;  // of a pixel
  // The surface does not end beside pixels that are missing at random.
  const float false_factor =
      budget.by_blocks && pinholes.are_by_chance() ? kChanceFalse : relief_detail::kFalseFactor;
  float missing = is_sparse ? kMissingFactor : budget.missing;
  // The blocks of kLive simplify contours before they are counted. Frames of a stream would have
  // fewer of the vertices of the frame before.
  const bool may_price = !is_sparse && !budget.by_blocks && !(options.stability > 1.0);
  if (may_price && has_much_contour(target)) missing *= kContourPrice;
  collapser.assign(*worked, mesh, keep, static_cast<float>(options.stability), missing,
                   false_factor);
  speck_area = collapser.area_of_specks(used / kSpeck);
  if (leaves_specks) collapser.leave_out_specks(mesh, used / kSpeck);
  if (budget.sweep_share > 0.0F)
    collapser.sweep(*worked, mesh, target, budget.sweep_share, progress);
  result.dropped_pixels =
      area * collapser.run(*worked, mesh, target, budget.round_share, off, progress);
  if (result.dropped_pixels > 0) result.stop = ReliefStop::kSmallPieces;
  if (has_many_pixels()) collapser = {};
  mesh.compact();  // what follows goes around its vertices several times
}

void Relief::Memory::refine(const Budget& budget) {
  refiner.assign(mesh);
  // Filled pixels weigh nothing: of twelve, too few would be left where many are.
  if (budget.by_sample && pinholes.num_filled() == 0) {
    refiner.flip_sampled(*worked, mesh, budget.flip_sweeps, budget.flip_floor, before, progress);
    return;
  }
  refiner.flip_edges(*worked, mesh, budget.flip_sweeps, budget.flip_floor, before, progress);
  for (int round = 0; round < budget.move_rounds; ++round) {
    const int moved = refiner.move_vertices(*worked, mesh, budget.radius, keep, progress);
    if (moved + refiner.flip_edges(*worked, mesh, budget.flip_sweeps, budget.flip_floor, before,
                                   progress) ==
        0)
      break;
  }
}

/// Takes every dense triangle: the target has room for all used pixels.
void Relief::Memory::take_all(ReliefResult& result) {
  worked = &surface;
  result.stop = ReliefStop::kAllPoints;
  result.dropped_pixels = 0;
  surface.dense_triangles(dense);
  mesh.assign(surface, dense);
  refiner.assign(mesh);
}

void Relief::Memory::fix_vertices() {
  if (keep.empty()) keep.assign(surface.num_pixels(), Keep::kFree);
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (mesh.vertex(v).alive()) keep[mesh.vertex(v).pixel] = Keep::kFixed;
  }
}

/// Is there a vertex at each pixel where the smaller mesh has one? It may have several there, whose
/// fans meet nowhere else; where these are one in the larger mesh, they are written as one.
bool Relief::Memory::holds(const Triangulation& smaller) {
  smaller.sorted_vertices(order, sorting);
  mesh.sorted_vertices(number, sorting);
  auto larger = number.cbegin();
  return std::ranges::all_of(order, [&](std::int32_t v) {
    const std::int32_t pixel = smaller.vertex(v).pixel;
    while (larger != number.cend() && mesh.vertex(*larger).pixel < pixel) ++larger;
    return larger != number.cend() && mesh.vertex(*larger).pixel == pixel;
  });
}

void Relief::Memory::make_mesh(const ReliefOptions& options, std::int64_t target, OffFaces off,
                               ReliefResult& result) {
  const Budget budget = budget_of(options.effort, target);
  select(options, target, off, result);
  // Edges are flipped around the boundary's last places; a quarter of the pixels is quicker.
  if (worked == &surface) move_boundary(options, target);
  refine(budget);
  if (worked != &surface) move_boundary(options, target);
  leave_pinholes();
}

/// Is a triangle neither at a pinhole nor cut in the end, as it lies off what was measured?
bool Relief::Memory::is_written(const Triangulation& of, std::int32_t t) const {
  Triangle pixels{};
  for (int i = 0; i < 3; ++i) {
    pixels[i] = of.vertex(of.triangle(t)[i]).pixel;
    if (is_pinhole(pixels[i])) return false;
    pixels[i] = seen().pixel_at(surface.input_u(pixels[i]), surface.input_v(pixels[i]));
    if (pixels[i] < 0) return true;  // nothing else was measured there
  }
  return !lies_off(seen(), pixels);
}

/// Coverage of the triangles that are written and not cut.
double Relief::Memory::written_coverage(const Triangulation& of) {
  Rows<std::int32_t, 2> pixels(of.num_slots(), 2);
  Rows<std::int32_t, 3> faces(of.num_face_slots(), 3);
  Eigen::Index num_faces = 0;
  for (std::int32_t t = 0; t < of.num_face_slots(); ++t) {
    if (!of.is_face(t)) continue;
    const auto& [a, b, c] = of.triangle(t);
    if (!is_written(of, t)) continue;
    for (const std::int32_t v : {a, b, c}) {
      const std::int32_t pixel = of.vertex(v).pixel;
      pixels.row(v) << static_cast<std::int32_t>(surface.input_u(pixel)),
          static_cast<std::int32_t>(surface.input_v(pixel));
    }
    faces.row(num_faces++) << a, b, c;
  }
  return coverage_of(surface, pixels, faces.topRows(num_faces), {}, coverage).whole.coverage;
}

/// Makes another mesh, and keeps it if it covers so many times as much as the one there is.
void Relief::Memory::try_mesh(const ReliefOptions& options, std::int64_t target, OffFaces off,
                              double factor, double& covered, ReliefResult& result) {
  std::swap(mesh, best);
  const auto [stop, dropped] = std::pair(result.stop, result.dropped_pixels);
  make_mesh(options, target, off, result);
  const double now = written_coverage(mesh);
  if (now > factor * covered) {
    covered = now;
    return;
  }
  std::swap(mesh, best);
  result.stop = stop;
  result.dropped_pixels = dropped;
}

/// Triangles that join what steps keep apart are cut from the mesh in the end. Of few vertices they
/// take most; to refuse them costs surface elsewhere, so that it depends which way leaves more.
///
/// A few depths that are far off are small pieces of a large area, whose loss counts like that of
/// the rest of the surface: without them more of that may be covered. Many vertices are enough for
/// both unless these pieces are much of the area.
///
/// Each collapse of few vertices can win surface as well as lose it, as where a bay is filled: with
/// fewer vertices more may be covered.
void Relief::Memory::make_best_mesh(const ReliefOptions& options, std::int64_t target,
                                    ReliefResult& result) {
  make_mesh(options, target, OffFaces::kTake, result);
  const bool is_hasty = options.effort == ReliefEffort::kLive;
  const bool is_few = target <= relief_detail::kFew;
  const int tries = is_few && levels.empty() && !is_hasty ? kFewTries : 0;
  const bool has_steps = is_few && surface.steps().has_steps();
  const bool much_speck = levels.empty() && speck_area > kMuchSpeck;
  const bool has_specks = much_speck || (tries > 0 && speck_area > 0.0);
  if (!has_steps && tries == 0 && !has_specks) return;
  double covered = written_coverage(mesh);
  if (has_steps) {
    try_mesh(options, target, OffFaces::kAvoid, 1.0, covered, result);
    try_mesh(options, target, OffFaces::kNever, kWorthLeaving, covered, result);
  }
  const auto end = std::ranges::lower_bound(kFewSizes, target);
  for (auto size = end; size != kFewSizes.begin() && end - size < tries;) {
    try_mesh(options, *--size, OffFaces::kTake, kWorthLeaving, covered, result);
  }
  leaves_specks = has_specks && kWorthLeaving * covered < 1.0;
  if (!leaves_specks) return;
  try_mesh(options, target, OffFaces::kTake, kWorthLeaving, covered, result);
  if (much_speck && has_steps)
    try_mesh(options, target, OffFaces::kNever, kWorthLeaving, covered, result);
  leaves_specks = false;
}

/// The last triangles may all be at pinholes or off the surface; one of the first triangulation of
/// what was measured never is.
void Relief::Memory::keep_a_face(ReliefResult& result) {
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (mesh.is_face(t) && is_written(mesh, t)) return;
  }
  mesh.assign(seen(), start.build(seen(), 0, 1, {}, false, progress));
  std::vector<Triangle> kept = relief_detail::few_faces(seen(), mesh, 3).corners;
  for (Triangle& corners : kept) {
    for (std::int32_t& p : corners) p = surface.pixel_at(seen().input_u(p), seen().input_v(p));
  }
  mesh.assign(surface, kept);
  refiner.assign(mesh);
  result.stop = ReliefStop::kSmallPieces;
  result.dropped_pixels = surface.num_used() - relief_detail::doubled_pixels(mesh) / 2;
}

void Relief::Memory::build_meshes(const PointGridView& grid, const ReliefOptions& options,
                                  ReliefResult& result) {
  for (auto size = options.levels.rbegin();; ++size) {
    const bool last = size == options.levels.rend();
    const std::int64_t target = last ? options.target_points : *size;
    choose_surface(options.effort, target);
    recall(grid, options);
    if (!levels.empty()) fix_vertices();
    make_best_mesh(options, target, result);
    if (levels.empty()) keep_a_face(result);
    // The vertices of the next smaller level are fixed. Where this size is hardly larger, they can
    // keep every legal collapse from reaching it; then that level is handed out again.
    if (!levels.empty() && (mesh.num_vertices() > target || !holds(levels.back()))) {
      mesh = levels.back();
      if (mesh.num_vertices() < target) result.stop = ReliefStop::kSmallerLevel;
    }
    if (last) return;
    levels.push_back(mesh);
  }
}

void Relief::Memory::find_sight(const ReliefOptions& options) {
  relief_detail::make_room(sight, mesh.num_slots());
  sight.resize(mesh.num_slots());
  const Vec3 center = (surface.center() / surface.unit()).cast<float>();
  const Vec3 parallel = surface.mean_normal();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    sight[v] = options.from_origin ? (mesh.vertex(v).point + center).normalized() : parallel;
  }
}

void Relief::Memory::release_meshes() {
  refiner = {};
  for (Triangulation* triangulation : {&mesh, &best}) *triangulation = {};
  for (auto* vertices : {&order, &sorting, &number, &written_pixels})
    relief_detail::release(*vertices);
  relief_detail::release(placed);
  half = {};
  if (pinholes.num_filled() > 0) surface = {};
}

void Relief::Memory::find_written(bool once) {
  written.resize(levels.size() + 1);
  for (std::vector<Written>& none : written) none.clear();
  if (pinholes.num_filled() == 0 && levels.empty() && !once) return;
  mesh.sorted_vertices(order, sorting);
  written_pixels.clear();
  for (const std::int32_t v : order) {
    const std::int32_t pixel = mesh.vertex(v).pixel;
    if (!once || written_pixels.empty() || written_pixels.back() != pixel) {
      written_pixels.push_back(pixel);
    }
  }
  find_written(mesh, written.back());
  for (std::size_t i = levels.size(); i-- > 0;) find_written(levels[i], written[i]);
}

void Relief::Memory::find_written(const Triangulation& of, std::vector<Written>& how) {
  may_write.assign(of.num_slots(), 0);
  of.sorted_vertices(order, sorting);
  auto larger = written_pixels.cbegin();  // of the next larger size
  const auto find = [&](std::int32_t pixel) {
    while (larger != written_pixels.cend() && *larger < pixel) ++larger;
    return larger != written_pixels.cend() && *larger == pixel;
  };
  for (const std::int32_t v : order) {
    const std::int32_t pixel = of.vertex(v).pixel;
    may_write[v] = find(pixel) && !is_pinhole(pixel) ? 1 : 0;
  }
  how.assign(of.num_slots(), Written::kNot);
  for (std::int32_t t = 0; t < of.num_face_slots(); ++t) {
    if (!of.is_face(t)) continue;
    const Triangle& corners = of.triangle(t);
    if (!std::ranges::all_of(corners, [&](std::int32_t v) { return may_write[v] != 0; })) continue;
    for (const std::int32_t v : corners) how[v] = Written::kWithLast;
  }
  larger = written_pixels.cbegin();
  std::vector<std::int32_t> own;
  for (const std::int32_t v : order) {
    const std::int32_t pixel = of.vertex(v).pixel;
    if (how[v] == Written::kNot || !find(pixel)) continue;
    how[v] = Written::kAsOwn;
    own.push_back(pixel);
    ++larger;
  }
  written_pixels.swap(own);
}

std::int32_t Relief::Memory::number_vertices(const Triangulation& of,
                                             std::span<const Written> how) {
  of.sorted_vertices(order, sorting);
  relief_detail::make_room(number, of.num_slots());
  number.resize(of.num_slots());
  const auto num_before = static_cast<std::int32_t>(placed.size());
  std::int32_t i = 0, latest = Triangulation::kNone;
  for (const std::int32_t v : order) {
    const std::int32_t pixel = of.vertex(v).pixel;
    const Written as = how.empty() ? Written::kAsOwn : how[v];
    if (as == Written::kNot) {
      number[v] = Triangulation::kNone;
      continue;
    }
    if (as == Written::kWithLast) {
      number[v] = number[latest];
    } else if (i < num_before && placed[i].pixel == pixel) {
      number[v] = placed[i++].number;
    } else {
      number[v] = static_cast<std::int32_t>(placed.size());
      placed.push_back({pixel, number[v]});
    }
    latest = v;
  }
  if (num_before > 0) std::sort(placed.begin(), placed.end());
  return static_cast<std::int32_t>(placed.size());
}

void Relief::Memory::write(const PointGridView& grid, const ReliefOptions& options,
                           ReliefResult& result) {
  placed.clear();
  find_written(takes_all(options));
  result.levels.resize(levels.size());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    ReliefLevel& level = result.levels[levels.size() - 1 - i];
    level.num_vertices = number_vertices(levels[i], written[i]);
    write_faces(levels[i], grid.rows_up, level.faces);
  }
  const Eigen::Index num_vertices = number_vertices(mesh, written.back());
  if (result.stop == ReliefStop::kTarget && num_vertices < options.target_points) {
    result.stop = ReliefStop::kSmallPieces;  // around pinholes
  }
  DepthMesh& out = result.mesh;
  previous.clear();
  const auto width = static_cast<double>(grid.cols), height = static_cast<double>(grid.rows);
  out.vertices.resize(num_vertices, 3);
  out.pixels.resize(num_vertices, 2);
  out.texcoords.resize(num_vertices, 2);
  for (const auto& [pixel, i] : placed) {
    const std::int64_t u_in = surface.input_u(pixel), v_in = surface.input_v(pixel);
    previous.push_back(v_in * grid.cols + u_in);
    const float* point = grid.points + 3 * previous.back();
    out.vertices.row(i) << point[0], point[1], point[2];
    out.pixels.row(i) << static_cast<std::int32_t>(u_in), static_cast<std::int32_t>(v_in);
    out.texcoords.row(i) << static_cast<float>((static_cast<double>(u_in) + 0.5) / width),
        static_cast<float>(1.0 - (static_cast<double>(v_in) + 0.5) / height);
  }
  write_faces(mesh, grid.rows_up, out.faces);
  leave_bridges(options, result);
  result.mean_move = result.max_move = 0.0;
  if (options.move_points) move_points(grid, options, result);
}

/// kLive has time for it on small images only, and meshes of many vertices have hardly any.
void Relief::Memory::leave_bridges(const ReliefOptions& options, ReliefResult& result) {
  const std::int64_t used = surface.num_used();
  const bool may_take_time = used < kSmall && options.target_points <= used / kHalf;
  if (options.effort == ReliefEffort::kLive && !may_take_time) return;
  const Rows<std::int32_t, 2>& pixels = result.mesh.pixels;
  relief_detail::remove_bridges(surface, pixels, result.mesh.faces, coverage);
  for (ReliefLevel& level : result.levels) {
    relief_detail::remove_bridges(surface, pixels, level.faces, coverage);
  }
}

void Relief::Memory::write_faces(const Triangulation& from, bool rows_up,
                                 Rows<std::int32_t, 3>& to) {
  const auto is_kept = [&](std::int32_t t) {
    return from.is_face(t) && std::ranges::none_of(from.triangle(t), [this](std::int32_t v) {
             return number[v] == Triangulation::kNone;
           });
  };
  Eigen::Index num_faces = 0;
  for (std::int32_t t = 0; t < from.num_face_slots(); ++t) num_faces += is_kept(t) ? 1 : 0;
  to.resize(num_faces, 3);
  Eigen::Index row = 0;
  for (std::int32_t t = 0; t < from.num_face_slots(); ++t) {
    if (!is_kept(t)) continue;
    auto [a, b, c] = from.triangle(t);
    if (!rows_up) std::swap(b, c);
    to.row(row++) << number[a], number[b], number[c];
  }
}

void Relief::Memory::move_points(const PointGridView& grid, const ReliefOptions& options,
                                 ReliefResult& result) {
  find_sight(options);
  refiner.fit(surface, mesh, sight);
  DepthMesh& out = result.mesh;
  double sum = 0.0;
  std::int32_t next = 0;
  for (const std::int32_t v : order) {  // no levels: numbered in this order
    const std::int32_t i = number[v];
    if (i != next) continue;  // a pixel's second fan, with the vertex of the first
    ++next;
    const Vec3 move = static_cast<float>(surface.unit()) * refiner.offset(v) * sight[v];
    out.vertices.row(i) += move.transpose();
    const double length = move.norm();
    sum += length;
    result.max_move = std::max(result.max_move, length);
    if (options.from_origin) continue;  // along the line of sight the pixel stays the same
    const Eigen::Vector2f step = surface.pixels_along(mesh.vertex(v).pixel, move);
    out.texcoords(i, 0) += step.x() / static_cast<float>(grid.cols);
    out.texcoords(i, 1) -= step.y() / static_cast<float>(grid.rows);
  }
  if (out.vertices.rows() > 0) result.mean_move = sum / static_cast<double>(out.vertices.rows());
}

void Relief::Memory::run(const PointGridView& grid, const ReliefOptions& options,
                         ReliefResult& result, std::span<const float> confidence) {
  levels.clear();
  const PointGridView taken = take_surface(grid, options, confidence);
  check_cancelled();
  result.filled_pixels = pinholes.num_filled();
  if (surface.empty()) {
    mesh.clear();
    levels.assign(options.levels.size(), mesh);
    result.stop = ReliefStop::kAllPoints;
    result.dropped_pixels = 0;
  } else if (takes_all(options)) {
    take_all(result);
    levels.assign(options.levels.size(), mesh);
  } else {
    build_meshes(taken, options, result);
  }
  check_cancelled();
  write(taken, options, result);
  if (has_many_pixels() && !(options.stability > 1.0)) release_meshes();
  check_cancelled();
  find_off(seen(), result.mesh.pixels, result.mesh.faces, result.off);
  CutCoverage found;
  if (options.measure_coverage) {
    found = coverage_of(seen(), result.mesh.pixels, result.mesh.faces, result.off, coverage);
  }
  result.cover = found.whole;
  result.cover_without_off = found.without_off;
  if (options.stability > 1.0) before.assign(surface, mesh);
}

Relief::Relief() : memory_(std::make_unique<Memory>()) {}
Relief::~Relief() = default;
Relief::Relief(Relief&&) noexcept = default;
Relief& Relief::operator=(Relief&&) noexcept = default;

void Relief::run(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result,
                 std::span<const float> confidence, const Progress& progress) {
  check_options(options);
  check_point_grid(grid);
  check_confidence(grid, confidence);
  memory_->progress = progress;
  try {
    memory_->run(grid, options, result, confidence);
  } catch (...) {
    reset();
    memory_->leaves_specks = false;
    throw;
  }
}

void Relief::run(const DepthView& depth, const PixelRays& rays, const ReliefOptions& options,
                 ReliefResult& result, std::span<const float> confidence,
                 const Progress& progress) {
  PointGrid& points = memory_->points;
  unproject(depth, rays, options.num_threads, points);
  run(points.view(), options, result, confidence, progress);
}

void Relief::reset() {
  memory_->previous.clear();
  memory_->before.clear();
}

ReliefResult relief(const PointGridView& grid, const ReliefOptions& options,
                    std::span<const float> confidence) {
  ReliefResult result;
  Relief().run(grid, options, result, confidence);
  return result;
}

Rows<std::int32_t, 3> flip_edges(const PointGridView& grid,
                                 const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                 const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                 std::span<const float> confidence) {
  check_point_grid(grid);
  check_confidence(grid, confidence);
  Surface surface;
  surface.assign(grid, {}, confidence, 1);
  std::vector<std::int32_t> vertex_at;
  if (surface.empty()) {
    if (faces.rows() > 0) throw InputError("faces: expected none without a surface");
    return faces;
  }
  Triangulation mesh;
  mesh.assign(surface, triangles_of(surface, grid, pixels, faces, vertex_at));
  const Budget budget = budget_of(ReliefEffort::kBalanced, pixels.rows());
  relief_detail::Refiner refiner;
  refiner.assign(mesh);
  refiner.flip_edges(surface, mesh, budget.flip_sweeps, budget.flip_floor, EdgeMemory(), {});
  Rows<std::int32_t, 3> flipped(faces.rows(), 3);
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    for (int i = 0; i < 3; ++i) {
      flipped(t, i) = vertex_at[mesh.vertex(mesh.triangle(t)[i]).pixel];
    }
    if (!grid.rows_up) std::swap(flipped(t, 1), flipped(t, 2));
  }
  return flipped;
}

}  // namespace manip3d
