#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "geometry/constants.hpp"
#include "manip3d/geometry/connected_runs.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The column of an azimuth, radians in [0, 2 pi], if the horizon is divided into columns.
inline int azimuth_column(double azimuth, int columns) {
  return std::min(static_cast<int>(azimuth * (columns / kFullTurn)), columns - 1);
}

/// One value per ring (or block of rings) and column; columns are cyclic around the horizon.
template <typename Value>
class RingImage {
 public:
  RingImage(int rings, int columns, Value value)
      : rings_(rings), columns_(columns), values_(std::int64_t{rings} * columns, value) {}

  [[nodiscard]] int rings() const { return rings_; }
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] const std::vector<Value>& values() const { return values_; }
  Value& operator()(int ring, int column) { return values_[index(ring, column)]; }
  const Value& operator()(int ring, int column) const { return values_[index(ring, column)]; }

  /// Maps a column in [-columns, 2 columns) to [0, columns).
  [[nodiscard]] int wrapped(int column) const {
    if (column < 0) return column + columns_;
    return column < columns_ ? column : column - columns_;
  }

 private:
  [[nodiscard]] std::int64_t index(int ring, int column) const {
    return std::int64_t{ring} * columns_ + column;
  }

  int rings_;
  int columns_;
  std::vector<Value> values_;
};

/// Morphological opening by a block of cells: erases all that no full block covers.
inline RingImage<std::uint8_t> opened(const RingImage<std::uint8_t>& image, int block_rings,
                                      int block_columns, Ticker& ticker) {
  RingImage<std::uint8_t> kept(image.rings(), image.columns(), 0);
  for (int ring = 0; ring + block_rings <= image.rings(); ++ring) {
    ticker.tick();
    for (int column = 0; column < image.columns(); ++column) {
      bool full = true;
      for (int r = 0; full && r < block_rings; ++r) {
        for (int c = 0; full && c < block_columns; ++c) {
          full = image(ring + r, image.wrapped(column + c)) != 0;
        }
      }
      if (!full) continue;
      for (int r = 0; r < block_rings; ++r) {
        for (int c = 0; c < block_columns; ++c) kept(ring + r, image.wrapped(column + c)) = 1;
      }
    }
  }
  return kept;
}

using RingCell = std::pair<int, int>;  ///< ring, column

/// Connected sets of cells with the value 1, with 8 neighbours and across the seam of the horizon,
/// in the order of their first cells, row by row.
inline std::vector<std::vector<RingCell>> connected_components(
    const RingImage<std::uint8_t>& image) {
  ConnectedRuns connected;
  const auto& runs = connected.find(image.values().data(), image.rings(), image.columns(), true);
  std::vector<std::vector<RingCell>> components(connected.num_components());
  for (const MarkedRun& run : runs) {
    for (std::int64_t c = run.first; c <= run.last; ++c) {
      components[run.component].emplace_back(run.row, c);
    }
  }
  return components;
}

}  // namespace manip3d
