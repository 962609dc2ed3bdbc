#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "manip3d/progress.hpp"

namespace manip3d {

/// An image of directions: 0 unmarked, 1 marked; from `window_sums`, counts of 0 to 9. Columns are
/// cyclic: column 0 is next to the last one. Cells above the first and below the last row are
/// unmarked.
struct CellMask {
  std::int64_t rows = 0, columns = 0;
  std::vector<std::uint8_t> cells;

  [[nodiscard]] std::uint8_t* row(std::int64_t r) { return cells.data() + r * columns; }
  [[nodiscard]] const std::uint8_t* row(std::int64_t r) const { return cells.data() + r * columns; }
};

/// Returns the number of marked cells, 0 to 9, in the 3x3 window around each cell. Rows without a
/// marked cell around them are skipped.
inline CellMask window_sums(const CellMask& mask, const Progress& progress) {
  if (mask.columns == 0) return mask;
  Ticker ticker(progress, 1U << 6);  // rows between two reports
  CellMask across{mask.rows, mask.columns, std::vector<std::uint8_t>(mask.cells.size())};
  std::vector<std::uint8_t> any(mask.rows);
  const std::int64_t n = mask.columns;
  for (std::int64_t r = 0; r < mask.rows; ++r) {
    ticker.tick();
    const std::uint8_t* from = mask.row(r);
    any[r] = *std::max_element(from, from + n);
    if (any[r] == 0) continue;
    std::uint8_t* to = across.row(r);
    for (std::int64_t c = 1; c + 1 < n; ++c) {
      to[c] = static_cast<std::uint8_t>(from[c - 1] + from[c] + from[c + 1]);
    }
    to[0] = static_cast<std::uint8_t>(from[n - 1] + from[0] + from[n > 1 ? 1 : 0]);
    to[n - 1] = static_cast<std::uint8_t>(from[n > 1 ? n - 2 : 0] + from[n - 1] + from[0]);
  }
  CellMask sums{mask.rows, mask.columns, std::vector<std::uint8_t>(mask.cells.size())};
  for (std::int64_t r = 0; r < mask.rows; ++r) {
    ticker.tick();
    for (std::int64_t k = std::max<std::int64_t>(0, r - 1); k <= std::min(mask.rows - 1, r + 1);
         ++k) {
      if (any[k] == 0) continue;
      std::uint8_t* to = sums.row(r);
      const std::uint8_t* from = across.row(k);
      for (std::int64_t c = 0; c < n; ++c) to[c] = static_cast<std::uint8_t>(to[c] + from[c]);
    }
  }
  return sums;
}

/// Marks the cells with at least `count` marked ones in the 3x3 window around them: 1 is a
/// dilation, 5 the median, 9 an erosion (beyond the first and last row, cells are unmarked).
inline CellMask rank_filter(const CellMask& mask, std::uint8_t count,
                            const Progress& progress = {}) {
  CellMask sums = window_sums(mask, progress);
  for (std::uint8_t& cell : sums.cells) cell = cell >= count ? 1 : 0;
  return sums;
}

}  // namespace manip3d
