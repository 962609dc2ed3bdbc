#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// Squares of pixels in which a surface ends or is cut, each triangulated on its own. The contour
/// within a square keeps every pixel at which it turns, in the image or strongly in space; the rest
/// of the square needs no vertex. A bisection would need intermediate triangles between single
/// pixels at the contour and large triangles.
///
/// Neighbouring squares choose the same vertices on their common side, by a rule that gives the
/// same result from either of them, so that together they are one mesh without gaps. It covers
/// exactly what the dense mesh covers.
class ContourBlocks {
 public:
  static constexpr int kSize = 4;  ///< Pixels of a side.

  enum class State : std::uint8_t {
    kEmpty,  ///< No surface.
    kWhole,  ///< Completely surface; vertices on its sides come from bisections only.
    kCut,    ///< Triangulated by this class.
  };

  void assign(const Surface& surface);
  /// State of the square that contains a pixel or starts at it.
  [[nodiscard]] State state(int u, int v) const { return states_[v / kSize * across_ + u / kSize]; }
  /// The state of all squares that have a pixel as a corner; kCut if they differ.
  [[nodiscard]] State around(int u, int v) const;
  /// Fills `out` by pixel: `whole` in whole squares and on their sides, else `other`.
  void fill(int cols, float whole, float other, std::vector<float>& out) const;
  /// Appends the triangles of the squares that are cut.
  /// @param errors     By pixel: pixels on a side whose error is at or above the threshold are
  ///                   vertices.
  /// @param threshold  An inner pixel becomes a vertex while its distance from its triangle, times
  ///                   twice the triangle's area, exceeds this.
  /// @param keep       By pixel, may be empty: pixels that are vertices in any case.
  void emit(const Surface& surface, std::span<const float> errors, float threshold,
            std::span<const Keep> keep, std::vector<Triangle>& out);

 private:
  /// Column and row within a square.
  struct Place {
    std::int32_t u = 0, v = 0;
    [[nodiscard]] bool is_on_side() const { return u == 0 || v == 0 || u == kSize || v == kSize; }
    [[nodiscard]] bool is_corner() const {
      return (u == 0 || u == kSize) && (v == 0 || v == kSize);
    }
  };
  struct Loop {
    std::int32_t first, last;  ///< Range in `places_`; `last` is exclusive.
  };
  using PlaceTriangle = std::array<Place, 3>;

  static std::int32_t doubled_area(const Place& a, const Place& b, const Place& c) {
    return (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
  }
  static std::uint32_t pixels_in(const Place& a, const Place& b, const Place& c);
  [[nodiscard]] std::int32_t pixel_of(const Surface& surface, const Place& p) const {
    return (v0_ + p.v) * surface.cols() + u0_ + p.u;
  }
  [[nodiscard]] State state_of(int column, int row) const {
    const bool is_inside = column >= 0 && row >= 0 && column < across_ && row < down_;
    return is_inside ? states_[row * across_ + column] : State::kEmpty;
  }
  void cut_beside(const Surface& surface, int column, int row);
  void find_edges(const Surface& surface);
  void add_edge(int from, int direction);
  /// Selects the pixels that are vertices in addition to those at which a contour turns.
  struct Marks {
    std::span<const float> errors;
    float threshold;
    std::span<const Keep> keep;
  };
  void trace(const Surface& surface, const Marks& marks, int start);
  /// @param direction  Direction in which the contour leaves the pixel.
  [[nodiscard]] bool is_vertex(const Surface& surface, const Marks& marks, const Place& p,
                               int direction) const;
  void join_holes();
  void join(const Loop& hole);
  [[nodiscard]] bool is_seen(const Place& from, const Place& to) const;
  void clip_ears(const Loop& loop);
  void insert_kept(const Surface& surface, std::span<const Keep> keep);
  void refine(const Surface& surface, float threshold);
  [[nodiscard]] bool find_farthest(const Surface& surface, const PlaceTriangle& corners,
                                   float& most, Place& farthest) const;
  void insert(const Place& place);

  int across_ = 0, down_ = 0;
  std::vector<State> states_, before_;
  // The current square.
  int u0_ = 0, v0_ = 0;
  /// By pixel, as bits: directions of the contour edges that start there.
  std::array<std::uint8_t, (kSize + 1) * (kSize + 1)> edges_{};
  std::vector<Place> places_, polygon_;
  std::vector<Loop> loops_;
  std::vector<PlaceTriangle> triangles_;
};

}  // namespace manip3d::relief_detail
