#include "manip3d/simplify/relief.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "simplify/relief/boundary.hpp"
#include "simplify/relief/collapse.hpp"
#include "simplify/relief/coverage.hpp"
#include "simplify/relief/exchange.hpp"
#include "simplify/relief/pinholes.hpp"
#include "simplify/relief/refine.hpp"
#include "simplify/relief/start.hpp"
#include "simplify/relief/surface.hpp"
#include "simplify/relief/triangulation.hpp"
#include "simplify/relief/unsure.hpp"
#include "simplify/relief/writer.hpp"

// This file runs the steps that Relief describes; each is made of the files of relief/:
//   dense surface            surface: cells and steps; links: neighbours; coverage by a mesh
//   0. pinholes              pinholes; unsure: pieces and pixels without confidence
//   1. first triangulation   start: bisection; blocks: contours of kLive
//   2. simplification        collapse; boundary: moves to the ends of the surface; few: a few faces
//   3. refinement            refine: flips and moves; exchange: merged and added vertices; bridges
//   4. move_points           refine: fit()
//   5. levels                writer: one order of the vertices of all meshes
// All work on a triangulation over pixels, whose triangles raster visits.

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

// "Pixels per vertex" below are the used pixels of the surface (those that a dense triangle uses)
// divided by the vertices of the target. The trials that led to these values are in
// benchmarks/results/depth.md, "Constants of relief".

/// From this many pixels per vertex on, inner vertices of the first triangulation at every second
/// pixel (Budget::finest) are enough.
constexpr std::int64_t kSparse = 32;

/// From this many pixels per vertex on, a mesh cannot follow a contour to the pixel, and a higher
/// price of false surface (Budget::sparse_false) only costs error.
constexpr std::int64_t kCoarse = 128;

/// Below this many used pixels, and from this many pixels per vertex on, kLive has time to remove
/// bridges.
constexpr std::int64_t kSmall = 50'000;
constexpr std::int64_t kFewBridges = 64;

/// ContourBlocks triangulate the contours above this many pixels per vertex. Meshes with fewer
/// pixels per vertex also need vertices inside the squares, which ContourBlocks leave out.
constexpr std::int64_t kDense = 6;

/// Price of false surface, relative to missing surface, where pixels are missing by chance: there,
/// little of it is false.
constexpr float kChanceFalse = 3.0F;

/// A mesh has much contour if it has more boundary vertices than kMuchContour times the target.
/// The price of missing surface is then multiplied by kContourPrice, unless the mesh is sparse
/// (kSparse), so that 0.99 of the surface is covered.
constexpr double kMuchContour = 1.5;
constexpr float kContourPrice = 4.0F;

/// Rounds of VertexExchange for sparse meshes (kSparse); each covers some more of the surface.
constexpr int kExchangeRounds = 4;

/// A mesh that leaves out parts of the surface, or has fewer vertices than allowed, replaces
/// another one if it covers more than this many times as much. The factor is above 1 because the
/// mean distance counts parts that are left out most of all.
constexpr double kWorthLeaving = 1.1;

/// For targets of at most kFew vertices, the kFewTries next smaller ones of these sizes are tried
/// as well: with few vertices, a collapse may gain surface.
constexpr int kFewTries = 3;
constexpr std::array<std::int64_t, 15> kFewSizes = {3,  4,  5,  6,  7,  8,  10, 12,
                                                    14, 16, 20, 25, 30, 40, 50};

/// For targets above kFew and up to kNearFew, meshes of kFew vertices are tried as well.
constexpr std::int64_t kNearFew = 2 * relief_detail::kFew;

/// If a mesh of few vertices that kLive made covers less than this, that of kFast is tried as well.
constexpr double kFallenApart = 0.5;

/// A connected piece of the surface is a speck if it has less than one in this many of the pixels.
constexpr std::int64_t kSpeck = 1000;

/// If specks are more than this share of the area, a mesh without them is also made for targets
/// above kFew vertices and for kLive: specks take a large share of the vertices then.
constexpr double kMuchSpeck = 0.1;

/// If specks would have more than this share of the vertices with a triangle each, as where noise
/// tears thin bars to pieces, Collapser::sweep() leaves out specks like Collapser::run(). Otherwise
/// the rest of the surface would give its vertices first.
constexpr double kManySpecks = 0.1;

/// Amount of work of an effort in each stage: each slower effort has a smaller error.
struct Budget {
  double start = 0.0;         ///< Bisections of the first triangulation per target vertex.
  double sparse_start = 0.0;  ///< Least `start` of sparse meshes (kSparse).
  int finest = 1;             ///< Pixels between inner vertices of a sparse first triangulation.
  float round_share = 0.3F;  ///< Largest share of the vertices that one round of collapses removes.
  int flip_sweeps = 3;
  float flip_floor =
      0.3F;                ///< Pairs of triangles with less than this many mean errors are skipped.
  bool by_sample = false;  ///< Use Refiner::flip_sampled(); `flip_floor` then counts mean volumes.
  int move_rounds = 0;     ///< Rounds of vertex moves, each followed by flips.
  int radius = 0;          ///< Farthest move of a vertex in one round, pixels.
  int boundary_sweeps = 4;
  bool by_tile = false;    ///< The first triangulation is ordered tile by tile.
  bool by_blocks = false;  ///< ContourBlocks triangulate the ends of the surface.
  /// Argument of Collapser::sweep(), which runs first and saves time; 0: it does not run.
  float sweep_share = 0.0F;
  /// The bisections per target vertex are at least `dense_start` times (target vertices / used
  /// pixels): dense targets need more bisections, because collapses choose vertices better than
  /// bisections and need some to choose from.
  double dense_start = 0.0;
  /// Collapser's factor on the price of missing surface below kSparse pixels per vertex. Sparser
  /// meshes use kMissingFactor: more would raise the error of scans seen from the side.
  float missing = kMissingFactor;
  /// Collapser's factor on the price of false surface between kSparse and kCoarse pixels per
  /// vertex; a higher one leaves fewer bridges.
  float sparse_false = relief_detail::kFalseFactor;
};

Budget budget_of(ReliefEffort effort, std::int64_t target) {
  switch (effort) {
    case ReliefEffort::kLive:
      return {.start = 0.4,
              .sparse_start = 2.0,
              .finest = 2,
              .round_share = 0.4F,
              .flip_sweeps = 2,
              .flip_floor = 0.1F,
              .by_sample = true,
              .boundary_sweeps = 2,
              .by_tile = true,
              .by_blocks = true,
              .sweep_share = 0.9F,
              .dense_start = 16.0,
              .missing = 20.0F,
              .sparse_false = 20.0F};
    case ReliefEffort::kFast:
      return {.start = 0.7, .dense_start = 18.0};
    case ReliefEffort::kBalanced:
      // With few vertices, larger rounds and finer first triangulations have up to 1.6 times the
      // error.
      if (target <= relief_detail::kFew) {
        return {.start = 1.0, .round_share = 0.2F, .move_rounds = 1, .radius = 1};
      }
      return {.start = 2.5, .move_rounds = 1, .radius = 1};
    case ReliefEffort::kFine:
      return {.start = 3.0, .round_share = 0.2F, .flip_sweeps = 4, .move_rounds = 2, .radius = 1};
    case ReliefEffort::kBest:
      break;
  }
  constexpr double kAllPixels = 1e9;  // select() bisects at most once for each used pixel
  return {
      .start = kAllPixels, .round_share = 0.1F, .flip_sweeps = 8, .move_rounds = 4, .radius = 2};
}

void check_options(const ReliefOptions& options) {
  if (options.target_points < 3) {
    throw InputError("target_points: expected at least 3, got " +
                     std::to_string(options.target_points));
  }
  if (!(options.stability >= 1.0)) {
    throw InputError("stability: expected at least 1, got " + number_text(options.stability));
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
      throw InputError("confidence: expected 0 to 1, got " + number_text(share));
    }
  }
}

/// Column and row of pixels of the input.
void list_pixels(std::span<const std::int32_t> pixels, std::int64_t cols,
                 Rows<std::int32_t, 2>& out) {
  out.resize(static_cast<Eigen::Index>(pixels.size()), 2);
  const auto width = static_cast<std::int32_t>(cols);
  for (Eigen::Index i = 0; i < out.rows(); ++i) out.row(i) << pixels[i] % width, pixels[i] / width;
}

/// Parts of the surface and faces that a mesh is made without.
struct LeftOut {
  OffFaces off = OffFaces::kTake;
  bool specks = false;
};

}  // namespace

struct Relief::Memory {
  PointGrid points;  ///< Points of the depth image, if one was given.
  relief_detail::UnsurePieces unsure;
  relief_detail::PinholeFiller pinholes;
  Surface surface;
  Surface measured;  ///< `surface` without the filled pinholes, if there are any.
  relief_detail::BoundaryMover boundary;
  relief_detail::StartMesh start;
  Triangulation mesh;
  Triangulation best;  ///< make_best_mesh(): the best mesh so far.
  relief_detail::Collapser collapser;
  relief_detail::VertexExchange exchange;
  relief_detail::Refiner refiner;
  relief_detail::ReliefWriter writer;
  std::vector<Vec3> sight;  ///< By vertex: unit direction in which it may slide.
  /// Scratch memory of holds().
  std::vector<std::int32_t> smaller_order, larger_order, sorting;
  std::vector<std::int64_t> previous;  ///< Input pixels of the vertices of the previous frame.
  EdgeMemory before;                   ///< Edges of the previous frame.
  relief_detail::CoverageScratch coverage;
  std::vector<Keep> keep;             ///< By pixel of the surface; or empty.
  std::vector<Triangulation> levels;  ///< The smaller meshes, smallest first.
  double speck_area = 0.0;            ///< Specks' share of the area in the latest select().
  Progress progress;                  ///< Throws if the run is cancelled.
  std::vector<Triangle> dense;        ///< Scratch memory of take_all() and select().

  /// Does the smallest target leave room for all used pixels?
  [[nodiscard]] bool takes_all(const ReliefOptions& options) const {
    const std::int64_t least =
        options.levels.empty() ? options.target_points : options.levels.back();
    return surface.num_used() <= least;
  }
  /// Builds the dense surface of a grid, without the pieces that have no confidence. It is
  /// continued over pinholes unless the target leaves room for all pixels.
  /// @return  the grid of that surface, with filled pinholes.
  PointGridView take_surface(const PointGridView& whole, const ReliefOptions& options,
                             std::span<const float> confidence);
  /// Moves vertices from filled pixels to measured ones.
  void leave_pinholes();
  [[nodiscard]] bool is_pinhole(std::int32_t pixel) const {
    return pinholes.num_filled() > 0 &&
           pinholes.is_filled(surface.input_v(pixel) * pinholes.grid().cols +
                              surface.input_u(pixel));
  }
  /// Moves the boundary of the mesh to the surface's ends.
  void move_boundary(const ReliefOptions& options, std::int64_t target);
  /// Marks the vertices of the previous frame in `keep`.
  void recall(const PointGridView& grid, const ReliefOptions& options);
  /// Vertices of the mesh that Collapser::leave_unsure() does not remove.
  [[nodiscard]] std::int64_t num_sure() const;
  /// Does the first triangulation have more contour than `target` vertices can follow?
  [[nodiscard]] bool has_much_contour(std::int64_t target) const;
  [[nodiscard]] bool is_sparse(std::int64_t target) const {
    return target <= surface.num_used() / kSparse;
  }
  /// Makes the first triangulation, of at least `target` vertices if the surface has so many.
  void triangulate(const Budget& budget, std::int64_t target);
  /// Collapser's factor on the price of missing surface.
  [[nodiscard]] float price_of_missing(const ReliefOptions& options, const Budget& budget,
                                       std::int64_t target) const;
  /// Triangulates and collapses edges until the mesh has at most `target` vertices.
  void select(const ReliefOptions& options, std::int64_t target, const LeftOut& left_out,
              ReliefResult& result);
  /// Does steps 1 to 3 of the operator (see Relief) for one size.
  void make_mesh(const ReliefOptions& options, std::int64_t target, const LeftOut& left_out,
                 ReliefResult& result);
  double written_coverage(const Triangulation& of);
  bool try_mesh(const ReliefOptions& options, std::int64_t target, const LeftOut& left_out,
                double factor, double& covered, ReliefResult& result);
  void make_best_mesh(const ReliefOptions& options, std::int64_t target, ReliefResult& result);
  /// Is there time to exchange vertices, and little contour for each vertex? In a stream, an
  /// exchange would replace vertices of the previous frame; specks of a large area would take more
  /// vertices from the rest.
  [[nodiscard]] bool may_exchange(const ReliefOptions& options, std::int64_t target) const {
    return budget_of(options.effort, target).move_rounds > 0 && !(options.stability > 1.0) &&
           speck_area <= kMuchSpeck && is_sparse(target);
  }
  /// Flips edges and moves vertices.
  void refine(const Budget& budget);
  /// The surface without filled pinholes.
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
  /// Can the mesh be the result for this size: is it small enough, and does it hold the next
  /// smaller level?
  [[nodiscard]] bool fits(std::int64_t target) {
    return levels.empty() || (mesh.num_vertices() <= target && holds(levels.back()));
  }
  void find_sight(const ReliefOptions& options);
  [[nodiscard]] bool has_many_pixels() const {
    return static_cast<std::int64_t>(surface.num_pixels()) > relief_detail::kManyPixels;
  }
  /// Frees the memory that is not needed after write().
  void release_meshes();
  /// Lets the run be cancelled between two stages.
  void check_cancelled() const {
    if (progress) progress(0.0);
  }
  void write(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
  void leave_bridges(const ReliefOptions& options, ReliefResult& result);
  void move_points(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
};

PointGridView Relief::Memory::take_surface(const PointGridView& whole, const ReliefOptions& options,
                                           std::span<const float> confidence) {
  surface.assign(whole, options.dense, confidence, options.num_threads);
  pinholes.clear();
  unsure.clear();
  PointGridView grid = whole;
  if (!surface.empty() && unsure.find(whole, surface)) {
    check_cancelled();
    grid = unsure.grid();
    surface.assign(grid, options.dense, confidence, options.num_threads);
  }
  if (surface.empty() || takes_all(options)) return grid;
  check_cancelled();
  if (!pinholes.fill(grid, options.dense, confidence, surface)) return grid;
  std::swap(surface, measured);
  check_cancelled();
  const PointGridView filled = pinholes.grid();
  // A full build is quicker than updates around many filled pixels.
  if (pinholes.are_by_chance() ||
      !surface.assign_filled(measured, filled, options.dense, pinholes.confidence(),
                             pinholes.filled())) {
    surface.assign(filled, options.dense, pinholes.confidence(), options.num_threads);
  }
  return filled;
}

void Relief::Memory::leave_pinholes() {
  if (pinholes.num_filled() == 0) return;
  refiner.leave_pixels(surface, mesh, keep,
                       [this](std::int32_t pixel) { return is_pinhole(pixel); });
}

void Relief::Memory::move_boundary(const ReliefOptions& options, std::int64_t target) {
  // kLive has no time to compute the price; few vertices should each cover as much as possible.
  const bool at_any_price = options.effort == ReliefEffort::kLive || target <= relief_detail::kFew;
  // Vertices of the previous frame (`keep`) stay, since that frame has moved them.
  boundary.run(surface, mesh, keep, budget_of(options.effort, target).boundary_sweeps, at_any_price,
               progress);
}

void Relief::Memory::recall(const PointGridView& grid, const ReliefOptions& options) {
  keep.clear();
  if (!(options.stability > 1.0)) before.clear();
  if (!(options.stability > 1.0) || previous.empty()) return;
  keep.assign(surface.num_pixels(), Keep::kFree);
  for (const std::int64_t pixel : previous) {
    const std::int32_t at = surface.pixel_at(pixel % grid.cols, pixel / grid.cols);
    if (at >= 0 && surface.is_used(at)) keep[at] = Keep::kPrefer;
  }
}

std::int64_t Relief::Memory::num_sure() const {
  if (!surface.avoids_unsure()) return mesh.num_vertices();
  std::int64_t count = 0;
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    const Triangulation::Vertex& vertex = mesh.vertex(v);
    count += vertex.alive() && (vertex.on_boundary || !surface.is_unsure(vertex.pixel)) ? 1 : 0;
  }
  return count;
}

bool Relief::Memory::has_much_contour(std::int64_t target) const {
  std::int64_t ends = 0;
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    ends += mesh.vertex(v).alive() && mesh.vertex(v).on_boundary ? 1 : 0;
  }
  return static_cast<double>(ends) > kMuchContour * static_cast<double>(target);
}

void Relief::Memory::triangulate(const Budget& budget, std::int64_t target) {
  const std::int64_t used = surface.num_used();
  const double density = static_cast<double>(target) / static_cast<double>(used);
  const double share = std::max(
      {budget.start, budget.dense_start * density, is_sparse(target) ? budget.sparse_start : 0.0});
  const double wanted = share * static_cast<double>(target);
  auto splits = static_cast<std::int64_t>(std::min(wanted, static_cast<double>(used)));
  int finest = is_sparse(target) ? budget.finest : 1;
  if (used <= target) splits = used, finest = 1;
  bool by_blocks = budget.by_blocks && kDense * target < used;
  const auto build = [&] {
    const std::span<const Triangle> faces =
        start.build(surface, splits, finest, keep, by_blocks, progress);
    check_cancelled();
    mesh.assign(surface, budget.by_tile ? start.order_by_tile(surface) : faces);
  };
  build();
  while (num_sure() < target && (splits < used || finest > 1 || by_blocks)) {
    if (splits == used) by_blocks = false;  // ContourBlocks leave pixels out
    splits = std::min(2 * splits, used);
    if (splits == used) finest = 1;
    build();
  }
  if (num_sure() < target && target < used) {
    // Bisection never ends at pixels in flat parts, and the others are too few for the target.
    surface.dense_triangles(dense);
    mesh.assign(surface, dense);
    if (has_many_pixels()) relief_detail::release(dense);
  }
  if (has_many_pixels()) {
    start = {};
    mesh.release_scratch();
  }
}

float Relief::Memory::price_of_missing(const ReliefOptions& options, const Budget& budget,
                                       std::int64_t target) const {
  if (is_sparse(target)) return kMissingFactor;
  // ContourBlocks have simplified the contours before has_much_contour() counts them. In a stream,
  // the higher price would keep fewer vertices of the previous frame.
  const bool may_rise = !budget.by_blocks && !(options.stability > 1.0);
  return may_rise && has_much_contour(target) ? kContourPrice * budget.missing : budget.missing;
}

void Relief::Memory::select(const ReliefOptions& options, std::int64_t target,
                            const LeftOut& left_out, ReliefResult& result) {
  const Budget budget = budget_of(options.effort, target);
  const std::int64_t used = surface.num_used();
  result.stop = used <= target ? ReliefStop::kAllPoints : ReliefStop::kTarget;
  result.dropped_pixels = 0;
  speck_area = 0.0;
  triangulate(budget, target);
  if (mesh.num_vertices() <= target) return;
  check_cancelled();
  const float missing = price_of_missing(options, budget, target);
  // Pixels that are missing by chance are no end of the surface, so little of the surface that
  // would cover them is false.
  const bool is_by_chance = budget.by_blocks && pinholes.are_by_chance();
  // Holes and steps in noise that is not believed should not be followed.
  const bool follows_contours =
      is_sparse(target) && target > used / kCoarse && !surface.avoids_unsure();
  const float false_factor = is_by_chance       ? kChanceFalse
                             : follows_contours ? budget.sparse_false
                                                : relief_detail::kFalseFactor;
  if (surface.avoids_unsure()) relief_detail::move_to_rims(surface, mesh, keep);
  collapser.assign(surface, mesh, keep, static_cast<float>(options.stability), missing,
                   false_factor);
  speck_area = collapser.area_of_specks(used / kSpeck);
  if (left_out.specks) collapser.leave_out_specks(mesh, used / kSpeck);
  if (surface.avoids_unsure()) collapser.leave_unsure(surface, mesh, target, progress);
  if (budget.sweep_share > 0.0F) {
    const std::int64_t specks =
        target > relief_detail::kFew ? collapser.num_specks(used / kSpeck) : 0;
    const bool is_many =
        3.0 * static_cast<double>(specks) > kManySpecks * static_cast<double>(target);
    collapser.sweep(surface, mesh, target, budget.sweep_share, is_many ? used / kSpeck : 0,
                    progress);
  }
  const auto [dropped, in_faces] =
      collapser.run(surface, mesh, target, budget.round_share, left_out.off, progress);
  result.dropped_pixels = dropped;
  if (dropped > 0) result.stop = in_faces ? ReliefStop::kFewFaces : ReliefStop::kSmallPieces;
  if (has_many_pixels()) collapser = {};
  mesh.compact();  // the later stages visit the vertices several times
}

void Relief::Memory::refine(const Budget& budget) {
  refiner.assign(mesh);
  // flip_sampled() takes twelve pixels of a pair of triangles. Filled pixels have weight 0, so that
  // too few of the twelve would count.
  if (budget.by_sample && pinholes.num_filled() == 0) {
    refiner.flip_sampled(surface, mesh, budget.flip_sweeps, budget.flip_floor, before, progress);
    if (surface.avoids_unsure()) refiner.flip_unsure(surface, mesh, before, progress);
    return;
  }
  refiner.flip_edges(surface, mesh, budget.flip_sweeps, budget.flip_floor, before, progress);
  for (int round = 0; round < budget.move_rounds; ++round) {
    const int moved = refiner.move_vertices(surface, mesh, budget.radius, keep, progress);
    if (moved + refiner.flip_edges(surface, mesh, budget.flip_sweeps, budget.flip_floor, before,
                                   progress) ==
        0)
      break;
  }
  if (surface.avoids_unsure()) refiner.flip_unsure(surface, mesh, before, progress);
}

/// Makes the mesh of all dense triangles, where the target leaves room for all used pixels.
void Relief::Memory::take_all(ReliefResult& result) {
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

/// Does the mesh have a vertex at each pixel where the smaller mesh has one? The smaller mesh may
/// have several vertices at a pixel, of fans that touch only there; if the larger mesh has one
/// vertex there, they are written as one.
bool Relief::Memory::holds(const Triangulation& smaller) {
  smaller.sorted_vertices(smaller_order, sorting);
  mesh.sorted_vertices(larger_order, sorting);
  auto larger = larger_order.cbegin();
  return std::ranges::all_of(smaller_order, [&](std::int32_t v) {
    const std::int32_t pixel = smaller.vertex(v).pixel;
    while (larger != larger_order.cend() && mesh.vertex(*larger).pixel < pixel) ++larger;
    return larger != larger_order.cend() && mesh.vertex(*larger).pixel == pixel;
  });
}

void Relief::Memory::make_mesh(const ReliefOptions& options, std::int64_t target,
                               const LeftOut& left_out, ReliefResult& result) {
  const Budget budget = budget_of(options.effort, target);
  select(options, target, left_out, result);
  move_boundary(options, target);  // flips should know the final boundary
  refine(budget);
  if (may_exchange(options, target) &&
      exchange.run(surface, mesh, keep, kExchangeRounds, progress)) {
    move_boundary(options, target);
    refine(budget);
  }
  if (has_many_pixels()) exchange = {};
  leave_pinholes();
}

/// Is a triangle in the final result: has it no vertex at a pinhole, and does it not lie off the
/// measured surface?
bool Relief::Memory::is_written(const Triangulation& of, std::int32_t t) const {
  Triangle pixels{};
  for (int i = 0; i < 3; ++i) {
    pixels[i] = of.vertex(of.triangle(t)[i]).pixel;
    if (is_pinhole(pixels[i])) return false;
    pixels[i] = seen().pixel_at(surface.input_u(pixels[i]), surface.input_v(pixels[i]));
    // The vertex lies outside the measured surface, so no step can be tested.
    if (pixels[i] < 0) return true;
  }
  return !lies_off(seen(), pixels);
}

/// Coverage of the triangles for which is_written() holds.
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
  return coverage_of(surface, pixels, faces.topRows(num_faces), {}, Rows<std::int32_t, 2>(),
                     coverage)
      .whole.coverage;
}

/// Makes another mesh. It replaces `mesh` if it fits and covers more than `factor` times `covered`,
/// which is the coverage of `mesh` (negative: `mesh` does not fit) and is updated.
/// @return  Whether it replaces `mesh`.
bool Relief::Memory::try_mesh(const ReliefOptions& options, std::int64_t target,
                              const LeftOut& left_out, double factor, double& covered,
                              ReliefResult& result) {
  std::swap(mesh, best);
  const auto [stop, dropped] = std::pair(result.stop, result.dropped_pixels);
  make_mesh(options, target, left_out, result);
  if (fits(target)) {
    const double now = written_coverage(mesh);
    if (now > factor * covered) {
      covered = now;
      return true;
    }
  }
  std::swap(mesh, best);
  result.stop = stop;
  result.dropped_pixels = dropped;
  return false;
}

/// Makes a mesh, where needed several in different ways, and keeps the one with the most coverage.
///
/// With depth steps: triangles that join surfaces on both sides of a step are cut from the mesh in
/// the end. Where there are few vertices, such triangles take most of them; refusing them loses
/// surface elsewhere. Both ways are tried.
///
/// With specks: a few outlying depths are small pieces of a large area, and losing them costs as
/// much as losing other surface of that area. Without them more of the rest may be covered. Many
/// vertices are enough for both, unless the specks are much of the area.
///
/// With few vertices: a collapse can gain surface as well as lose it, for example where it fills a
/// bay, so that a mesh with fewer vertices may cover more.
///
/// With not many more vertices: the mesh of kFew vertices is the best of several and may cover
/// more.
///
/// With few vertices and kLive: the contours that ContourBlocks keep can leave too few vertices for
/// the surface.
void Relief::Memory::make_best_mesh(const ReliefOptions& options, std::int64_t target,
                                    ReliefResult& result) {
  make_mesh(options, target, {}, result);
  const bool is_hasty = options.effort == ReliefEffort::kLive;
  const bool is_few = target <= relief_detail::kFew;
  const int tries = is_few && levels.empty() && !is_hasty ? kFewTries : 0;
  const bool has_steps = surface.steps().has_steps();
  const bool is_near_few = !is_few && target <= kNearFew && levels.empty();
  const bool may_fall_apart = is_few && levels.empty() && is_hasty;
  const bool much_speck = levels.empty() && speck_area > kMuchSpeck;
  const bool has_specks = much_speck || (tries > 0 && speck_area > 0.0);
  if (!(is_few && has_steps) && tries == 0 && !is_near_few && !may_fall_apart && !has_specks)
    return;
  double covered = fits(target) ? written_coverage(mesh) : -1.0;
  const auto try_size = [&](std::int64_t size, const LeftOut& left_out,
                            double factor = kWorthLeaving) {
    const bool is_better = try_mesh(options, size, left_out, factor, covered, result);
    if (is_better && size < target && result.stop != ReliefStop::kFewFaces)
      result.stop = ReliefStop::kFewerPoints;
  };
  const auto try_without_off = [&](std::int64_t size, double factor) {
    try_size(size, {OffFaces::kAvoid}, factor);
    try_size(size, {OffFaces::kNever});
  };
  // Smaller meshes (kNearFew) can cover less than a mesh of this size without specks, and yet so
  // much that it is no longer worth leaving them out.
  if (!is_few && has_specks && kWorthLeaving * covered < 1.0)
    try_size(target, {OffFaces::kTake, true});
  if (is_few && has_steps) try_without_off(target, 1.0);
  if (is_near_few && kWorthLeaving * covered < 1.0) {
    try_size(relief_detail::kFew, {});
    if (has_steps) try_without_off(relief_detail::kFew, kWorthLeaving);
  }
  if (may_fall_apart && covered < kFallenApart) {
    ReliefOptions slower = options;
    slower.effort = ReliefEffort::kFast;
    try_mesh(slower, target, {}, kWorthLeaving, covered, result);
  }
  const auto end = std::ranges::lower_bound(kFewSizes, target);
  for (auto size = end; size != kFewSizes.begin() && end - size < tries;) {
    try_size(*--size, {});
  }
  if (!(is_few && has_specks && kWorthLeaving * covered < 1.0)) return;
  try_size(target, {OffFaces::kTake, true});
  if (much_speck && has_steps) try_size(target, {OffFaces::kNever, true});
}

/// Makes sure that at least one triangle is written. All triangles of the mesh may be at pinholes
/// or off the surface; the first triangulation of the measured surface has none of these, and the
/// result is then a few of its triangles.
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
  result.stop = ReliefStop::kFewFaces;
  result.dropped_pixels = surface.num_used() - relief_detail::doubled_pixels(mesh) / 2;
}

void Relief::Memory::build_meshes(const PointGridView& grid, const ReliefOptions& options,
                                  ReliefResult& result) {
  for (auto size = options.levels.rbegin();; ++size) {
    const bool last = size == options.levels.rend();
    const std::int64_t target = last ? options.target_points : *size;
    recall(grid, options);
    if (!levels.empty()) fix_vertices();
    const std::int64_t dropped_before = result.dropped_pixels;
    make_best_mesh(options, target, result);
    if (levels.empty()) keep_a_face(result);
    // The vertices of the next smaller level are fixed. If this size is hardly larger, they may
    // leave no legal collapse that reaches it; the result is then that smaller level again.
    if (!fits(target)) {
      mesh = levels.back();
      result.dropped_pixels = dropped_before;
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
  for (auto* vertices : {&smaller_order, &larger_order, &sorting})
    relief_detail::release(*vertices);
  writer = {};
  if (pinholes.num_filled() > 0) surface = {};
}

void Relief::Memory::write(const PointGridView& grid, const ReliefOptions& options,
                           ReliefResult& result) {
  relief_detail::ReliefWriter::Meshes meshes{.surface = surface,
                                             .mesh = mesh,
                                             .levels = levels,
                                             .is_pinhole = {},
                                             .once = takes_all(options)};
  if (pinholes.num_filled() > 0) {
    meshes.is_pinhole = [this](std::int32_t pixel) { return is_pinhole(pixel); };
  }
  writer.write(meshes, grid, result);
  const Rows<std::int32_t, 2>& pixels = result.mesh.pixels;
  if (result.stop == ReliefStop::kTarget && pixels.rows() < options.target_points) {
    result.stop = ReliefStop::kPinholes;
  }
  previous.clear();
  for (Eigen::Index i = 0; i < pixels.rows(); ++i) {
    previous.push_back(std::int64_t{pixels(i, 1)} * grid.cols + pixels(i, 0));
  }
  leave_bridges(options, result);
  result.mean_move = result.max_move = 0.0;
  if (options.move_points) move_points(grid, options, result);
}

/// Leaves out triangles that are bridges (see remove_bridges). kLive has time for this on small
/// images only, and there only for few vertices: dense meshes have hardly any bridges.
void Relief::Memory::leave_bridges(const ReliefOptions& options, ReliefResult& result) {
  const std::int64_t used = surface.num_used();
  const bool may_take_time = used < kSmall && options.target_points <= used / kFewBridges;
  if (options.effort == ReliefEffort::kLive && !may_take_time) return;
  const Rows<std::int32_t, 2>& pixels = result.mesh.pixels;
  relief_detail::remove_bridges(surface, pixels, result.mesh.faces, coverage);
  for (ReliefLevel& level : result.levels) {
    relief_detail::remove_bridges(surface, pixels, level.faces, coverage);
  }
}

void Relief::Memory::move_points(const PointGridView& grid, const ReliefOptions& options,
                                 ReliefResult& result) {
  find_sight(options);
  refiner.fit(surface, mesh, sight);
  DepthMesh& out = result.mesh;
  double sum = 0.0;
  std::int32_t next = 0;
  // Without levels, the output is numbered in this order.
  for (const std::int32_t v : writer.order()) {
    const std::int32_t i = writer.number(v);
    if (i != next) continue;  // not written, or written with the vertex before it
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
  if (!confidence.empty()) surface.avoid_unsure();
  check_cancelled();
  const std::span<const std::int32_t> filled = pinholes.filled();
  list_pixels(pinholes.num_filled() > 0 ? filled : filled.first(0), grid.cols, result.filled);
  list_pixels(unsure.pixels(), grid.cols, result.unsure);
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
    found = coverage_of(seen(), result.mesh.pixels, result.mesh.faces, result.off, result.filled,
                        coverage);
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

}  // namespace manip3d
