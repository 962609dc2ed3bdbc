#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace manip3d {

/// Layer of a distance, given its square in square metres.
int range_layer(float squared_range);

/// A direction and a distance: rows of lasers, columns around the horizon, and layers of range that
/// are a quarter of an octave thick.
struct RangeVoxel {
  int row, column, layer;
};

/// The voxels of a scan that hold points, numbered row by row: one in twenty does, so that values
/// per number fit into the processor's cache where values per voxel do not.
class RangeVoxels {
 public:
  static constexpr int kLayers = 32;  // 0.5 to 128 m, and what is beyond in the first and last

  /// A run of numbers: neighbours in range that hold points.
  struct Numbers {
    std::int32_t first, last;  ///< The last is not part of the run.
  };

  RangeVoxels(int rows, int columns)
      : rows_(rows), columns_(columns), cells_(std::int64_t{rows} * columns) {}

  /// Marks a voxel that holds a point.
  void add(const RangeVoxel& at) { cells_[cell(at.row, at.column)].layers |= 1U << at.layer; }

  /// Numbers the voxels, after the last was added.
  void number();

  [[nodiscard]] int rows() const { return rows_; }
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] std::size_t size() const { return voxels_.size(); }
  [[nodiscard]] const std::vector<RangeVoxel>& voxels() const { return voxels_; }

  /// Number of a voxel that holds points.
  [[nodiscard]] std::int32_t operator()(const RangeVoxel& at) const {
    const Cell& in = cells_[cell(at.row, at.column)];
    return in.first + std::popcount(in.layers & ((1U << at.layer) - 1U));
  }

  /// Numbers of the voxels from layer `near` to layer `far`, both included, that hold points.
  [[nodiscard]] Numbers numbers(int row, int column, int near, int far) const {
    const Cell& at = cells_[cell(row, column)];
    const std::uint32_t nearer = (1U << near) - 1U;
    const std::uint32_t up_to = 0xFFFFFFFFU >> (kLayers - 1 - far);
    if ((at.layers & up_to & ~nearer) == 0) return {0, 0};
    return {at.first + std::popcount(at.layers & nearer),
            at.first + std::popcount(at.layers & up_to)};
  }

 private:
  struct Cell {
    std::uint32_t layers = 0;  // bit k: layer k holds points
    std::int32_t first = 0;    // number of the lowest layer that does
  };

  [[nodiscard]] std::int64_t cell(int row, int column) const {
    return std::int64_t{row} * columns_ + column;
  }

  int rows_;
  int columns_;
  std::vector<Cell> cells_;
  std::vector<RangeVoxel> voxels_;
};

/// Points of a voxel, and those whose range is more than a quarter step off.
struct RangeTally {
  std::int32_t points = 0;
  std::int32_t incoherent = 0;
};

/// Voxels in windows that hold more incoherent ranges than chance explains.
///
/// Windows of three sizes lie around each voxel with incoherent ranges. The value of each voxel is
/// Chernoff's exponent of the strongest window that covers it: clean points of a window reach an
/// exponent t with probability e^-t at most. Windows below `threshold` count as 0.
/// @param tallies  (voxels.size(),)
std::vector<float> incoherent_windows(const RangeVoxels& voxels,
                                      const std::vector<RangeTally>& tallies, double incoherence,
                                      double threshold);

}  // namespace manip3d
