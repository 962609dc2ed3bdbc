#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace manip3d {

/// Points of a voxel, and those whose range is more than a quarter step off.
struct RangeTally {
  std::int32_t points = 0;
  std::int32_t incoherent = 0;
};

/// A value per direction and distance: rows of lasers, columns around the horizon, and layers of
/// range that are a quarter of an octave thick.
template <typename Value>
class RangeVoxels {
 public:
  static constexpr int kLayers = 32;  // 0.5 to 128 m, and what is beyond in the first and last

  RangeVoxels(int rows, int columns, Value value)
      : rows_(rows),
        columns_(columns),
        values_(static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns) * kLayers,
                value) {}

  [[nodiscard]] int rows() const { return rows_; }
  [[nodiscard]] int columns() const { return columns_; }
  Value& operator()(int row, int column, int layer) { return values_[index(row, column, layer)]; }
  const Value& operator()(int row, int column, int layer) const {
    return values_[index(row, column, layer)];
  }

 private:
  [[nodiscard]] std::size_t index(int row, int column, int layer) const {
    return (static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
            static_cast<std::size_t>(column)) *
               kLayers +
           static_cast<std::size_t>(layer);
  }

  int rows_;
  int columns_;
  std::vector<Value> values_;
};

/// Layer of a distance, given its square in square metres.
int range_layer(float squared_range);

/// Voxels in windows that hold more incoherent ranges than chance explains.
///
/// Windows of three sizes lie around each voxel with incoherent ranges. The value is Chernoff's
/// exponent of the strongest window that covers a voxel: clean points of a window reach an exponent
/// t with probability e^-t at most. Windows below `threshold` count as 0.
RangeVoxels<float> incoherent_windows(const RangeVoxels<RangeTally>& voxels, double incoherence,
                                      double threshold);

}  // namespace manip3d
