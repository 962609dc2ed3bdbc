#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "simplify/relief/surface.hpp"
#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// Finds the pieces of a surface in whose pixels there is no confidence, such as a reflection that
/// lies a depth step behind a window. Nothing else would remove them: they cost little to keep, and
/// the surface around them has nothing in common with them.
class UnsurePieces {
 public:
  /// Finds the pieces whose mean confidence is below Surface::least_sure(). A piece has the pixels
  /// that dense triangles connect. If no pixel has any confidence, no piece is found.
  /// @return  whether there is such a piece; grid() must not be used otherwise.
  bool find(const PointGridView& grid, const Surface& surface);

  /// The grid in which the pixels of these pieces were not measured.
  [[nodiscard]] PointGridView grid() const { return grid_; }
  /// Pixels of the grid that were measured and belong to these pieces.
  [[nodiscard]] std::span<const std::int32_t> pixels() const { return pixels_; }
  void clear() { pixels_.clear(); }

 private:
  enum Mark : std::uint8_t { kNew, kOwn, kDone };
  [[nodiscard]] bool is_unsure(const Surface& surface, std::int32_t first, float least);

  PointGridView grid_;
  std::vector<std::uint8_t> valid_;
  std::vector<std::int32_t> pixels_;
  std::vector<std::uint8_t> marks_;  ///< By pixel of the surface.
  std::vector<std::int32_t> piece_;  ///< Pixels of the surface that is_unsure() has found.
};

/// Moves each inner vertex without confidence to the nearest pixel within its triangles that has
/// some. Around a region without confidence, these vertices are at its rim then: when the others
/// merge into them, the new triangles lie over the region and hardly over anything else.
/// @param keep  By pixel, may be empty: vertices at fixed pixels stay.
void move_to_rims(const Surface& surface, Triangulation& mesh, std::span<const Keep> keep);

}  // namespace manip3d::relief_detail
