#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace manip3d {

/// The layer of a point, from its squared distance in square metres.
int range_layer(float squared_range);

/// A cell of directions and distances: rows of lasers, columns around the horizon, and layers of
/// range, each of which is a quarter of an octave thick.
struct RangeVoxel {
  int row, column, layer;
};

/// The voxels of a scan that hold points, numbered row by row. One voxel in twenty holds points, so
/// that arrays by number fit into the processor's cache, while arrays of all voxels do not.
class RangeVoxels {
 public:
  // 0.5 to 128 m; the first and last layer also hold nearer and farther points
  static constexpr int kLayers = 32;

  /// A half-open interval of numbers [first, last): adjacent layers of one direction.
  struct Numbers {
    std::int32_t first, last;
  };

  RangeVoxels(int rows, int columns)
      : rows_(rows), columns_(columns), cells_(std::int64_t{rows} * columns) {}

  /// Marks a voxel as holding a point.
  void add(const RangeVoxel& at) { cells_[cell(at.row, at.column)].layers |= 1U << at.layer; }

  /// Assigns the numbers. Call it once, after the last add().
  void number();

  [[nodiscard]] int rows() const { return rows_; }
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] std::size_t size() const { return voxels_.size(); }
  [[nodiscard]] const std::vector<RangeVoxel>& voxels() const { return voxels_; }

  /// The number of a voxel that holds points.
  [[nodiscard]] std::int32_t operator()(const RangeVoxel& at) const {
    const Cell& in = cells_[cell(at.row, at.column)];
    return in.first + std::popcount(in.layers & ((1U << at.layer) - 1U));
  }

  /// The numbers of the voxels with points in layers `near` to `far`, both included.
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
    std::int32_t first = 0;    // number of the first such layer
  };

  [[nodiscard]] std::int64_t cell(int row, int column) const {
    return std::int64_t{row} * columns_ + column;
  }

  int rows_;
  int columns_;
  std::vector<Cell> cells_;
  std::vector<RangeVoxel> voxels_;
};

/// Counts of a voxel's points, and of those whose range is more than a quarter step off
/// (incoherent).
struct RangeTally {
  std::int32_t points = 0;
  std::int32_t incoherent = 0;
};

/// Finds windows that hold more incoherent ranges than chance explains.
///
/// Windows of three sizes are placed around each voxel with incoherent ranges. The value of a voxel
/// is the Chernoff exponent of the strongest window that covers it: a window of clean points
/// reaches an exponent of t or more with probability e^-t at most. Windows below `threshold` count
/// as 0.
/// @param tallies      (voxels.size(),)
/// @param incoherence  Probability that the range of a clean point is incoherent.
std::vector<float> incoherent_windows(const RangeVoxels& voxels,
                                      const std::vector<RangeTally>& tallies, double incoherence,
                                      double threshold);

}  // namespace manip3d
