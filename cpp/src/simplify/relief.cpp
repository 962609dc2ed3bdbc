#include "manip3d/simplify/relief.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "simplify/relief_collapse.hpp"
#include "simplify/relief_refine.hpp"
#include "simplify/relief_start.hpp"
#include "simplify/relief_surface.hpp"
#include "simplify/relief_triangulation.hpp"

namespace manip3d {
namespace {

using relief_detail::Surface;
using relief_detail::Triangulation;
using relief_detail::Vec3;

/// What an effort spends. Measured on the Stanford scans; each step pays for itself.
struct Budget {
  double start;       ///< Bisections of the first triangulation per target point.
  float round_share;  ///< Of the vertices that a round of collapses may remove.
  int flip_sweeps;
  float flip_floor;  ///< Pairs of triangles below this many mean errors are not looked at.
  int move_rounds;   ///< Of moves and flips.
  int radius;        ///< Of a move, pixels.
};

Budget budget_of(ReliefEffort effort) {
  switch (effort) {
    case ReliefEffort::kLive:
      return {0.4, 0.4F, 1, 1.0F, 0, 0};
    case ReliefEffort::kFast:
      return {0.7, 0.3F, 3, 0.3F, 0, 0};
    case ReliefEffort::kBalanced:
      return {1.0, 0.2F, 3, 0.3F, 1, 1};
    case ReliefEffort::kFine:
      return {3.0, 0.2F, 4, 0.3F, 2, 1};
    case ReliefEffort::kBest:
      break;
  }
  return {1e9, 0.1F, 8, 0.3F, 4, 2};
}

void check_options(const ReliefOptions& options) {
  if (options.target_points < 3) {
    throw InputError("target_points: expected at least 3, got " +
                     std::to_string(options.target_points));
  }
  if (!(options.stability >= 1.0)) {
    throw InputError("stability: expected at least 1, got " + std::to_string(options.stability));
  }
  if (!(options.max_edge > 0.0)) {
    throw InputError("max_edge: expected > 0, got " + std::to_string(options.max_edge));
  }
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

}  // namespace

struct Relief::Memory {
  Surface surface;
  relief_detail::StartMesh start;
  Triangulation mesh;
  relief_detail::Collapser collapser;
  relief_detail::Refiner refiner;
  std::vector<Vec3> sight;             ///< By vertex: where it may slide.
  std::vector<std::int32_t> order;     ///< Output vertex -> vertex.
  std::vector<std::int32_t> number;    ///< Vertex -> output vertex.
  std::vector<std::int64_t> previous;  ///< Input pixels of the frame before.
  std::vector<std::uint8_t> keep;      ///< By pixel of the surface: is one of them; or empty.
  std::vector<Triangulation> levels;
  std::vector<std::int32_t> rank;  ///< By vertex: in how many of the levels it is.

  void recall(const PointGridView& grid, const ReliefOptions& options);
  void select(const ReliefOptions& options, ReliefResult& result);
  void refine(const Budget& budget);
  void find_levels(const ReliefOptions& options);
  void find_sight(const ReliefOptions& options);
  void write(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
  void write_triangles(const Triangulation& from, bool rows_up, Rows<std::int32_t, 3>& to);
  void move_points(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result);
};

void Relief::Memory::recall(const PointGridView& grid, const ReliefOptions& options) {
  keep.clear();
  if (!(options.stability > 1.0) || previous.empty()) return;
  keep.assign(static_cast<std::size_t>(surface.cols()) * static_cast<std::size_t>(surface.rows()),
              0);
  for (const std::int64_t pixel : previous) {
    const std::int64_t u = pixel % grid.cols - surface.input_u(0);
    const std::int64_t v = pixel / grid.cols - surface.input_v(0);
    if (u < 0 || v < 0 || u >= surface.cols() || v >= surface.rows()) continue;
    const auto at = static_cast<std::int32_t>(v * surface.cols() + u);
    keep[at] = surface.sample(at).area > 0.0F ? 1 : 0;
  }
}

void Relief::Memory::select(const ReliefOptions& options, ReliefResult& result) {
  const Budget budget = budget_of(options.effort);
  const std::int64_t target = options.target_points;
  const double splits =
      std::min(budget.start * static_cast<double>(target), static_cast<double>(surface.num_used()));
  mesh.assign(surface, start.build(surface, static_cast<std::int64_t>(splits), keep));
  result.stop = ReliefStop::kTarget;
  result.dropped_pixels = 0;
  if (surface.num_used() <= target) {
    mesh.assign(surface, start.build(surface, surface.num_used(), keep));
    result.stop = ReliefStop::kAllPoints;
  }
  if (mesh.num_vertices() <= target && options.levels.empty()) return;
  collapser.assign(mesh, keep, static_cast<float>(options.stability));
  collapser.run(surface, mesh, target, budget.round_share);
  if (mesh.num_vertices() > target) {
    result.stop = ReliefStop::kSmallPieces;
    result.dropped_pixels = relief_detail::drop_small_pieces(mesh, target);
  }
}

void Relief::Memory::refine(const Budget& budget) {
  refiner.assign(mesh);
  refiner.flip_edges(surface, mesh, budget.flip_sweeps, budget.flip_floor);
  for (int round = 0; round < budget.move_rounds; ++round) {
    const int moved = refiner.move_vertices(surface, mesh, budget.radius, keep);
    if (moved + refiner.flip_edges(surface, mesh, budget.flip_sweeps, budget.flip_floor) == 0)
      break;
  }
}

void Relief::Memory::find_levels(const ReliefOptions& options) {
  const Budget budget = budget_of(options.effort);
  const auto flipped = [&](Triangulation copy) {
    refiner.assign(copy);
    refiner.flip_edges(surface, copy, budget.flip_sweeps, budget.flip_floor);
    return copy;
  };
  rank.assign(static_cast<std::size_t>(mesh.num_slots()), 0);
  Triangulation largest = flipped(mesh);
  for (const std::int64_t size : options.levels) {
    collapser.run(surface, mesh, size, budget.round_share);
    if (mesh.num_vertices() > size) relief_detail::drop_small_pieces(mesh, size);
    for (std::int32_t v = 0; v < mesh.num_slots(); ++v) rank[v] += mesh.vertex(v).alive() ? 1 : 0;
    levels.push_back(flipped(mesh));
  }
  mesh = std::move(largest);
}

void Relief::Memory::find_sight(const ReliefOptions& options) {
  sight.resize(static_cast<std::size_t>(mesh.num_slots()));
  const Vec3 center = (surface.center() / surface.unit()).cast<float>();
  const Vec3 parallel = surface.mean_normal();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    sight[v] = options.from_origin ? (mesh.vertex(v).point + center).normalized() : parallel;
  }
}

void Relief::Memory::write(const PointGridView& grid, const ReliefOptions& options,
                           ReliefResult& result) {
  order.clear();
  for (std::int32_t v = 0; v < mesh.num_slots(); ++v) {
    if (mesh.vertex(v).alive()) order.push_back(v);
  }
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    if (!rank.empty() && rank[a] != rank[b]) return rank[a] > rank[b];
    return std::pair(mesh.vertex(a).pixel, a) < std::pair(mesh.vertex(b).pixel, b);
  });
  number.resize(static_cast<std::size_t>(mesh.num_slots()));
  DepthMesh& out = result.mesh;
  previous.clear();
  const auto width = static_cast<double>(grid.cols), height = static_cast<double>(grid.rows);
  const auto num_vertices = static_cast<Eigen::Index>(order.size());
  out.vertices.resize(num_vertices, 3);
  out.pixels.resize(num_vertices, 2);
  out.uvs.resize(num_vertices, 2);
  for (Eigen::Index i = 0; i < num_vertices; ++i) {
    const std::int32_t v = order[static_cast<std::size_t>(i)];
    number[v] = static_cast<std::int32_t>(i);
    const std::int64_t u_in = surface.input_u(mesh.vertex(v).pixel);
    const std::int64_t v_in = surface.input_v(mesh.vertex(v).pixel);
    previous.push_back(v_in * grid.cols + u_in);
    const float* point = grid.points + 3 * previous.back();
    out.vertices.row(i) << point[0], point[1], point[2];
    out.pixels.row(i) << static_cast<std::int32_t>(u_in), static_cast<std::int32_t>(v_in);
    out.uvs.row(i) << static_cast<float>((static_cast<double>(u_in) + 0.5) / width),
        static_cast<float>(1.0 - (static_cast<double>(v_in) + 0.5) / height);
  }
  write_triangles(mesh, grid.rows_up, out.triangles);
  result.levels.resize(levels.size());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    result.levels[i].num_vertices = levels[i].num_vertices();
    write_triangles(levels[i], grid.rows_up, result.levels[i].triangles);
  }
  result.mean_move = result.max_move = 0.0;
  if (options.move_points) move_points(grid, options, result);
}

void Relief::Memory::write_triangles(const Triangulation& from, bool rows_up,
                                     Rows<std::int32_t, 3>& to) {
  Eigen::Index num_triangles = 0;
  for (std::int32_t t = 0; t < from.num_triangle_slots(); ++t) num_triangles += from.is_triangle(t);
  to.resize(num_triangles, 3);
  Eigen::Index row = 0;
  for (std::int32_t t = 0; t < from.num_triangle_slots(); ++t) {
    if (!from.is_triangle(t)) continue;
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
  for (Eigen::Index i = 0; i < out.vertices.rows(); ++i) {
    const std::int32_t v = order[static_cast<std::size_t>(i)];
    const Vec3 move = static_cast<float>(surface.unit()) * refiner.offset(v) * sight[v];
    out.vertices.row(i) += move.transpose();
    const double length = move.norm();
    sum += length;
    result.max_move = std::max(result.max_move, length);
    if (options.from_origin) continue;  // along the line of sight the pixel stays the same
    const Eigen::Vector2f step = surface.pixels_along(mesh.vertex(v).pixel, move);
    out.uvs(i, 0) += step.x() / static_cast<float>(grid.cols);
    out.uvs(i, 1) -= step.y() / static_cast<float>(grid.rows);
  }
  if (out.vertices.rows() > 0) result.mean_move = sum / static_cast<double>(out.vertices.rows());
}

Relief::Relief() : memory_(std::make_unique<Memory>()) {}
Relief::~Relief() = default;
Relief::Relief(Relief&&) noexcept = default;
Relief& Relief::operator=(Relief&&) noexcept = default;

void Relief::run(const PointGridView& grid, const ReliefOptions& options, ReliefResult& result) {
  check_options(options);
  check_point_grid(grid);
  Memory& m = *memory_;
  m.levels.clear();
  m.rank.clear();
  m.surface.assign(grid, options.max_edge, options.num_threads);
  if (m.surface.empty()) {
    m.mesh.clear();
    result.stop = ReliefStop::kAllPoints;
    result.dropped_pixels = 0;
  } else {
    m.recall(grid, options);
    m.select(options, result);
    if (options.levels.empty()) {
      m.refine(budget_of(options.effort));
    } else {
      m.find_levels(options);
    }
  }
  m.write(grid, options, result);
}

void Relief::reset() { memory_->previous.clear(); }

ReliefResult relief(const PointGridView& grid, const ReliefOptions& options) {
  ReliefResult result;
  Relief().run(grid, options, result);
  return result;
}

}  // namespace manip3d
