#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/progress.hpp"
#include "simplify/relief/raster.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

inline PixelPlace place_of(const Triangulation& mesh, std::int32_t v) {
  return {mesh.vertex(v).u, mesh.vertex(v).v};
}

/// The price of a missing pixel beside a fan, whose centre is v.
[[nodiscard]] float price_of_pixel(const Triangulation& mesh, const Triangulation::Fan& fan,
                                   std::int32_t v);

/// Whether the segments ab and pq of pixels (column, row) have a common point.
[[nodiscard]] bool segments_meet(const PixelPlace& a, const PixelPlace& b, const PixelPlace& p,
                                 const PixelPlace& q);

/// The boundary edges of a triangulation by tiles of pixels. Each edge goes from a vertex to its
/// first neighbour.
class BoundaryTiles {
 public:
  /// Replaces the edges by all those of a mesh.
  void collect(const Surface& surface, const Triangulation& mesh);
  /// Adds the edge from a boundary vertex.
  void add(const Triangulation& mesh, std::int32_t from);
  /// Whether a test is true for any edge near the segment ab, given the vertex from which the edge
  /// goes. All edges that meet the segment are tested, also if each end has moved by one pixel
  /// since its edge was added; others may be, and some more than once.
  template <typename Test>
  [[nodiscard]] bool any_near(const PixelPlace& a, const PixelPlace& b, Test&& test) const {
    const Box box = box_of(a, b);
    for (int v = box.v0; v <= box.v1; ++v) {
      for (int u = box.u0; u <= box.u1; ++u) {
        for (std::int32_t k = newest_in_[v * across_ + u]; k >= 0; k = entries_[k].older) {
          if (test(entries_[k].from)) return true;
        }
      }
    }
    return false;
  }

 private:
  struct Entry {
    std::int32_t from, older;  ///< The next entry of the same tile, or -1.
  };
  struct Box {
    int u0, v0, u1, v1;  ///< First and last tiles.
  };
  /// The tiles of a box around two pixels, each of which may move by one.
  [[nodiscard]] Box box_of(const PixelPlace& a, const PixelPlace& b) const;

  int across_ = 0, down_ = 0;
  std::vector<std::int32_t> newest_in_;  ///< By tile: its last entry, or -1.
  std::vector<Entry> entries_;
};

/// Moves the boundary of a triangulation to the ends of the surface, pixel by pixel. Removed
/// vertices left cuts and bays.
class BoundaryMover {
 public:
  /// In each of at most `sweeps` passes, moves each boundary vertex to that one of its eight
  /// neighbour pixels with which the mesh covers most additional pixels; a pixel without surface
  /// (or across a cut) counts -10. No triangle folds over, and boundaries do not meet.
  /// @param keep          By pixel, may be empty: only vertices at kFree pixels move.
  /// @param at_any_price  If false, a vertex stays if a move would increase the distance of its
  ///                      triangles from the surface by more than the gain is worth, as at the end
  ///                      of a crease.
  void run(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep, int sweeps,
           bool at_any_price, const Progress& progress);

 private:
  class Vertex;
  bool move(const Surface& surface, Triangulation& mesh, bool at_any_price, std::int32_t v);
  /// @param gains  By step, the pixels that the mesh gains; 0: not possible.
  /// @return  the pixel after the step with the most gain that is legal and worth it; -1: none.
  [[nodiscard]] std::int32_t first_legal(const Vertex& vertex, std::array<int, 9> gains,
                                         bool at_any_price) const;
  /// Whether a boundary edge of the vertex would meet another one if the vertex moved.
  [[nodiscard]] bool meets_other(const Vertex& vertex, const PixelPlace& to) const;

  /// By vertex: no move of it has a gain, until it or a neighbour moves.
  std::vector<std::uint8_t> is_settled_;
  BoundaryTiles tiles_;
};

}  // namespace manip3d::relief_detail
