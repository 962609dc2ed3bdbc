#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/progress.hpp"
#include "simplify/relief_triangulation.hpp"

namespace manip3d::relief_detail {

/// Moves the boundary of a triangulation to where the surface ends, pixel by pixel: vertices that
/// went left cuts and bays behind, and a mesh of every second pixel stops up to two pixels early.
class BoundaryMover {
 public:
  /// In each of at most `sweeps` passes, each vertex on the boundary goes to the one of its eight
  /// neighbours that covers most pixels more, one that is not surface (or across a cut) counting as
  /// minus ten. Nothing folds over, and no boundary meets another one.
  /// @param keep  by pixel, may be empty: vertices at pixels that are not free stay.
  /// @param at_any_price  false: a vertex stays where its triangles would leave the surface by more
  ///                      than what is won is worth, as at the end of a crease.
  void run(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep, int sweeps,
           bool at_any_price, const Progress& progress);

 private:
  using Pixel = std::array<std::int32_t, 2>;  ///< Column and row.
  struct Edge {
    std::int32_t from, to;
  };
  void collect_edges(const Surface& surface, const Triangulation& mesh);
  template <typename Visit>
  void visit_tiles(const std::array<Pixel, 3>& corners, Visit&& visit) const;
  bool move(const Surface& surface, Triangulation& mesh, bool at_any_price, std::int32_t v);
  [[nodiscard]] bool meets_other(const Triangulation& mesh, std::int32_t v, std::int32_t first,
                                 std::int32_t last, const Pixel& to) const;

  /// By vertex: it gains nothing by a move, nor does it before it or a neighbour of it has moved.
  std::vector<std::uint8_t> is_settled_;
  int tiles_across_ = 0, tiles_down_ = 0;
  std::vector<Edge> edges_;             ///< On the boundary.
  std::vector<std::int32_t> first_in_;  ///< By tile and one more: where in `in_tile_` it starts.
  std::vector<std::int32_t> in_tile_;   ///< Edges by tile.
};

}  // namespace manip3d::relief_detail
