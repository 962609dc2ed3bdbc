#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

namespace manip3d {

/// A binary image whose columns go round: column 0 is the neighbour of the last one. Beyond the
/// first and the last row there is nothing.
struct CellMask {
  std::int64_t rows = 0, columns = 0;
  std::vector<std::uint8_t> cells;

  [[nodiscard]] std::uint8_t* row(std::int64_t r) { return cells.data() + r * columns; }
  [[nodiscard]] const std::uint8_t* row(std::int64_t r) const { return cells.data() + r * columns; }
};

/// Sums over 3x3 windows; rows without a marked cell around them cost nothing.
inline CellMask window_sums(const CellMask& mask) {
  CellMask across{mask.rows, mask.columns, std::vector<std::uint8_t>(mask.cells.size())};
  std::vector<std::uint8_t> any(static_cast<std::size_t>(mask.rows));
  const std::int64_t n = mask.columns;
  for (std::int64_t r = 0; r < mask.rows; ++r) {
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

/// 1 where at least `count` of the nine cells around are marked: 1 dilates, 5 is the median, 9
/// erodes (the border counts as unmarked).
inline CellMask rank_filter(const CellMask& mask, std::uint8_t count) {
  CellMask sums = window_sums(mask);
  for (std::uint8_t& cell : sums.cells) cell = cell >= count ? 1 : 0;
  return sums;
}

/// Component of each run of marked cells, in the order of rows and columns.
struct MaskRun {
  std::int64_t row, first, last;  // columns, both inside
  std::int32_t component = 0;
};

namespace internal {

inline std::int32_t find_root(std::vector<std::int32_t>& parent, std::int32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

inline bool touch(const MaskRun& a, const MaskRun& b, std::int64_t columns) {
  if (a.first <= b.last + 1 && b.first <= a.last + 1) return true;
  return (a.first == 0 && b.last == columns - 1) || (b.first == 0 && a.last == columns - 1);
}

}  // namespace internal

/// Runs of marked cells with their components (8 neighbours), numbered by first appearance.
inline std::vector<MaskRun> find_components(const CellMask& mask) {
  std::vector<MaskRun> runs;
  std::vector<std::size_t> row_start(static_cast<std::size_t>(mask.rows) + 1);
  for (std::int64_t r = 0; r < mask.rows; ++r) {
    row_start[r] = runs.size();
    const std::uint8_t* cells = mask.row(r);
    const std::uint8_t* const end = cells + mask.columns;
    for (const std::uint8_t* c = std::find(cells, end, 1); c != end; c = std::find(c, end, 1)) {
      const std::uint8_t* last = std::find(c, end, 0);
      runs.push_back({r, c - cells, last - cells - 1});
      c = last;
    }
  }
  row_start[mask.rows] = runs.size();
  std::vector<std::int32_t> parent(runs.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto join = [&](std::size_t i, std::size_t j) {
    const std::int32_t a = internal::find_root(parent, static_cast<std::int32_t>(i));
    const std::int32_t b = internal::find_root(parent, static_cast<std::int32_t>(j));
    parent[std::max(a, b)] = std::min(a, b);
  };
  for (std::int64_t r = 0; r < mask.rows; ++r) {
    const std::size_t begin = row_start[r];
    const std::size_t end = row_start[r + 1];
    if (end - begin > 1 && internal::touch(runs[begin], runs[end - 1], mask.columns)) {
      join(begin, end - 1);
    }
    if (r == 0 || begin == end) continue;
    std::size_t first = row_start[r - 1];  // of the runs that may still touch
    for (std::size_t i = begin; i < end; ++i) {
      while (first < begin && runs[first].last + 1 < runs[i].first) ++first;
      for (std::size_t j = first; j < begin && runs[j].first <= runs[i].last + 1; ++j) join(i, j);
    }
    if (begin > row_start[r - 1]) {  // round the back
      for (const std::size_t i : {begin, end - 1}) {
        for (const std::size_t j : {row_start[r - 1], begin - 1}) {
          if (internal::touch(runs[i], runs[j], mask.columns)) join(i, j);
        }
      }
    }
  }
  std::vector<std::int32_t> number(runs.size(), -1);
  std::int32_t count = 0;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    std::int32_t& mine = number[internal::find_root(parent, static_cast<std::int32_t>(i))];
    if (mine < 0) mine = count++;
    runs[i].component = mine;
  }
  return runs;
}

}  // namespace manip3d
