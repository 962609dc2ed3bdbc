#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/lanes.hpp"
#include "manip3d/progress.hpp"
#include "simplify/relief_blocks.hpp"
#include "simplify/relief_triangulation.hpp"

namespace manip3d::relief_detail {

/// A first, adaptive triangulation of a surface by longest-edge bisection: right triangles whose
/// long side is halved where the surface leaves it [Duchaineau et al., "ROAMing terrain", 1997;
/// Lindstrom et al. 1996]. Where the surface ends or is cut it goes down to single pixels and keeps
/// the dense mesh's triangles, so that it covers exactly the same pixels.
class StartMesh {
 public:
  /// Halves where the error is largest: at most `num_vertices` times, not counting what the edges
  /// of the surface need.
  /// @param finest  power of two: pixels between the vertices of the finest grid; finer ones only
  ///                where the edges of the surface need them.
  /// @param keep  by pixel, may be empty: pixels that become vertices in any case.
  /// @param by_blocks  the surface's ends are triangulated by ContourBlocks, and bisections
  ///                   weighed by the area around them instead of their pixels.
  std::span<const Triangle> build(const Surface& surface, std::int64_t num_vertices, int finest,
                                  std::span<const Keep> keep, bool by_blocks,
                                  const Progress& progress);
  /// Orders the triangles tile by tile: neighbours are then near each other in memory, which is
  /// what loops around vertices wait for.
  std::span<const Triangle> order_by_tile(const Surface& surface);

 private:
  void measure(const Surface& surface, int finest, std::span<const Keep> keep, Ticker& ticker);
  void measure_pixels(const Surface& surface);
  [[nodiscard]] Float4 raised(const Surface& surface, Float4 errors, std::int32_t first, int stride,
                              const std::array<std::int32_t, 4>& away, float weight) const;
  template <typename Part, typename Away>
  void measure_row(const Surface& surface, std::span<const Keep> keep, int v, int first, int step,
                   bool is_measured, Part&& part, Away&& away);
  void measure_sides(const Surface& surface, int finest, std::span<const Keep> keep, int step,
                     Ticker& ticker);
  void measure_diagonals(const Surface& surface, int finest, std::span<const Keep> keep, int step,
                         Ticker& ticker);
  void count_errors(const Surface& surface, int step, float least);
  [[nodiscard]] float counted_threshold(std::int64_t num_vertices) const;
  [[nodiscard]] float threshold_for(const Surface& surface, std::int64_t num_vertices, int finest);
  void find_busy_tiles(const Surface& surface, float threshold);
  template <typename Visit>
  void visit_busy(int cols, int v, int first, int stride, int end, Visit&& visit);
  void emit(const Surface& surface, float threshold, std::span<const Keep> keep);
  void emit_cells(const Surface& surface, float threshold);
  void emit_fans(const Surface& surface, float threshold, int step);

  /// Is a pixel in a square that bisections leave to `blocks_`, at a step within it?
  [[nodiscard]] bool is_left_out(int u, int v, int step) const {
    return by_blocks_ && step < ContourBlocks::kSize &&
           blocks_.state(u, v) != ContourBlocks::State::kWhole;
  }

  /// How much the distance of a pixel counts.
  [[nodiscard]] float weight_of(const Surface& surface, std::int32_t pixel) const {
    return by_blocks_ ? surface.sample(pixel).weight : surface.confidence(pixel);
  }

  bool by_blocks_ = false;  ///< In the latest build().
  ContourBlocks blocks_;
  std::vector<float> errors_;  ///< By pixel: of the bisection there, at least that of its parts.
  std::vector<std::uint8_t> busy_;  ///< By tile: is something in it bisected?
  std::vector<std::int32_t> histogram_;
  std::vector<Triangle> faces_, ordered_;
  std::vector<std::int32_t> first_in_;  ///< By tile: where in `ordered_` it starts.
  std::vector<std::int32_t> tiles_;     ///< By triangle of `faces_`.
};

}  // namespace manip3d::relief_detail
