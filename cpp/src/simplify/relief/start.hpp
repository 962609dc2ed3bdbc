#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/lanes.hpp"
#include "manip3d/progress.hpp"
#include "simplify/relief/blocks.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// A first, adaptive triangulation of a surface by longest-edge bisection: right triangles whose
/// longest side is halved where the surface deviates from it [Duchaineau et al., "ROAMing terrain",
/// 1997; Lindstrom et al. 1996]. Where the surface ends or is cut, it is refined to single pixels
/// and keeps the triangles of the dense mesh, so that it covers exactly the same pixels.
class StartMesh {
 public:
  /// Bisects where the error is largest, at most `num_vertices` times, not counting bisections at
  /// the ends of the surface.
  /// @param finest     Power of two: pixels between the vertices of the finest grid; finer ones are
  ///                   used only at the ends of the surface.
  /// @param keep       By pixel, may be empty: pixels that become vertices in any case.
  /// @param by_blocks  The ends of the surface are triangulated by ContourBlocks, and errors of
  ///                   bisections are weighted by area instead of by pixels.
  std::span<const Triangle> build(const Surface& surface, std::int64_t num_vertices, int finest,
                                  std::span<const Keep> keep, bool by_blocks,
                                  const Progress& progress);
  /// Orders the triangles tile by tile, so that neighbours are near each other in memory, on which
  /// the speed of loops around vertices depends.
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

  /// Whether a pixel is in a square that is left to `blocks_`, for a step within the square.
  [[nodiscard]] bool is_left_out(int u, int v, int step) const {
    return by_blocks_ && step < ContourBlocks::kSize &&
           blocks_.state(u, v) != ContourBlocks::State::kWhole;
  }

  /// Weight of the distance of a pixel.
  [[nodiscard]] float weight_of(const Surface& surface, std::int32_t pixel) const {
    return by_blocks_ ? surface.sample(pixel).weight : surface.confidence(pixel);
  }

  bool by_blocks_ = false;  ///< Argument of the latest build().
  ContourBlocks blocks_;
  /// By pixel: error of the bisection there, at least that of its parts.
  std::vector<float> errors_;
  std::vector<std::uint8_t> busy_;  ///< By tile: whether something in it is bisected.
  std::vector<std::int32_t> histogram_;
  std::vector<Triangle> faces_, ordered_;
  std::vector<std::int32_t> first_in_;  ///< By tile: index of its first triangle in `ordered_`.
  std::vector<std::int32_t> tiles_;     ///< By triangle of `faces_`: its tile.
};

}  // namespace manip3d::relief_detail
