#pragma once

#include <array>
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
  /// @return  Its place, for number_at().
  std::int32_t add(const RangeVoxel& at) {
    const auto place = static_cast<std::int32_t>(cell(at.row, at.column));
    cells_[place].layers |= 1U << at.layer;
    return place * kLayers + at.layer;
  }

  /// Assigns the numbers. Call it once, after the last add().
  void number();

  [[nodiscard]] int rows() const { return rows_; }
  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] std::size_t size() const { return voxels_.size(); }
  [[nodiscard]] const std::vector<RangeVoxel>& voxels() const { return voxels_; }

  /// The number of a voxel that holds points, from its place.
  [[nodiscard]] std::int32_t number_at(std::int32_t place) const {
    return number_in(cells_[place / kLayers], place % kLayers);
  }

  /// The number of a voxel; -1: it holds no points.
  [[nodiscard]] std::int32_t find(const RangeVoxel& at) const {
    const Cell& in = cells_[cell(at.row, at.column)];
    return (in.layers >> at.layer & 1U) != 0 ? number_in(in, at.layer) : -1;
  }

  /// The numbers of the voxels with points in layers `near` to `far`, both included.
  [[nodiscard]] Numbers numbers(int row, int column, int near, int far) const {
    const Cell& at = cells_[cell(row, column)];
    const std::uint32_t nearer = (1U << near) - 1U;
    const std::uint32_t up_to = 0xFFFFFFFFU >> (kLayers - 1 - far);
    if ((at.layers & up_to & ~nearer) == 0) return {0, 0};
    return {at.first + count_bits(at.layers & nearer), at.first + count_bits(at.layers & up_to)};
  }

 private:
  struct Cell {
    std::uint32_t layers = 0;  // bit k: layer k holds points
    std::int32_t first = 0;    // number of the first such layer
  };

  [[nodiscard]] std::int64_t cell(int row, int column) const {
    return std::int64_t{row} * columns_ + column;
  }

  [[nodiscard]] static std::int32_t number_in(const Cell& cell, int layer) {
    return cell.first + count_bits(cell.layers & ((1U << layer) - 1U));
  }

  // Number of bits that are set, added in groups of 2, 4 and 8 bits. std::popcount is a call of a
  // function where the compiler may not use the processor's instruction.
  [[nodiscard]] static std::int32_t count_bits(std::uint32_t bits) {
    bits -= bits >> 1U & 0x55555555U;
    bits = (bits & 0x33333333U) + (bits >> 2U & 0x33333333U);
    return static_cast<std::int32_t>(((bits + (bits >> 4U)) & 0x0F0F0F0FU) * 0x01010101U >> 24U);
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
