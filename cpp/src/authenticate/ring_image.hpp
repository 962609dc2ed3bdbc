#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace manip3d {

/// One value per ring (or block of rings) and column; columns go around the horizon.
template <typename Value>
class RingImage {
 public:
  RingImage(int rings, int columns, Value value)
      : rings_(rings),
        columns_(columns),
        values_(static_cast<std::size_t>(rings) * static_cast<std::size_t>(columns), value) {}

  [[nodiscard]] int rings() const { return rings_; }
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] const std::vector<Value>& values() const { return values_; }
  Value& operator()(int ring, int column) { return values_[index(ring, column)]; }
  const Value& operator()(int ring, int column) const { return values_[index(ring, column)]; }

  /// A column up to one turn away, in [0, columns).
  [[nodiscard]] int wrapped(int column) const {
    if (column < 0) return column + columns_;
    return column < columns_ ? column : column - columns_;
  }

 private:
  [[nodiscard]] std::size_t index(int ring, int column) const {
    return static_cast<std::size_t>(ring) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column);
  }

  int rings_;
  int columns_;
  std::vector<Value> values_;
};

using RingCell = std::pair<int, int>;  ///< ring, column

/// Sets of cells that are not 0 and touch each other, corners included, around the horizon too.
/// In the order of their first cells, row by row.
template <typename Value>
std::vector<std::vector<RingCell>> connected_components(const RingImage<Value>& image) {
  RingImage<std::uint8_t> seen(image.rings(), image.columns(), 0);
  std::vector<std::vector<RingCell>> components;
  for (int ring = 0; ring < image.rings(); ++ring) {
    for (int column = 0; column < image.columns(); ++column) {
      if (image(ring, column) == Value{} || seen(ring, column) != 0) continue;
      seen(ring, column) = 1;
      std::vector<RingCell> cells = {{ring, column}};
      for (std::size_t next = 0; next < cells.size(); ++next) {
        const auto [r, c] = cells[next];
        for (int dr = -1; dr <= 1; ++dr) {
          if (r + dr < 0 || r + dr >= image.rings()) continue;
          for (int dc = -1; dc <= 1; ++dc) {
            const int column_beside = image.wrapped(c + dc);
            if (image(r + dr, column_beside) == Value{}) continue;
            if (seen(r + dr, column_beside) != 0) continue;
            seen(r + dr, column_beside) = 1;
            cells.emplace_back(r + dr, column_beside);
          }
        }
      }
      components.push_back(std::move(cells));
    }
  }
  return components;
}

}  // namespace manip3d
