#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/authenticate/watermark.hpp"

/// @file
/// The order of points that both ends of a watermark derive from what embedding leaves alone.
namespace manip3d {

/// One point of a tile's message: what the watermark binds, 16 bytes, little-endian.
struct WatermarkSample {
  std::int32_t x, y, z, intensity;

  // Without branches: neighbours in canonical order often share their first fields.
  friend bool operator==(const WatermarkSample& a, const WatermarkSample& b) {
    return ((a.x ^ b.x) | (a.y ^ b.y) | (a.z ^ b.z) | (a.intensity ^ b.intensity)) == 0;
  }
};

/// Directions between slices, counter-clockwise from the x axis, times 2^28.
class SliceTable {
 public:
  /// @throws InputError  not 4 to 360 slices.
  explicit SliceTable(int num_slices);

  [[nodiscard]] int size() const { return static_cast<int>(x_.size()); }
  /// The slices of `count` samples, or of points of three coordinates; (0, 0) is in slice 0. A
  /// boundary belongs to the slice that follows it.
  void find(const WatermarkSample* samples, std::size_t count, std::uint16_t* slices) const;
  void find(const float* xyz, std::size_t count, std::uint16_t* slices) const;

 private:
  template <typename Wide, std::size_t kStride, typename Value>
  void find_all(const Value* xy, std::size_t count, std::uint16_t* slices) const;

  std::vector<std::int32_t> x_, y_;     // the direction where each slice begins
  std::vector<std::uint16_t> guesses_;  // slice at the beginning of each cell of diamond angles
};

/// Points of each slice.
std::vector<std::uint32_t> count_slices(const std::vector<std::uint16_t>& slices, int num_slices);

/// Merges slices until each tile has `least` points; returns the tile of each slice.
std::vector<std::uint16_t> merge_slices(const std::vector<std::uint32_t>& counts,
                                        std::uint32_t least, WatermarkMerge merge);

/// Which fields come first in the order, behind the tile.
enum class WatermarkOrder : std::uint8_t {
  kHeightFirst,   ///< z, rho^2, x, y, intensity.
  kColumnsFirst,  ///< x, y, intensity, z.
  kPlain,         ///< z, x, y, intensity: for bit patterns, of which no rho^2 can be had.
};

/// Samples of all tiles, tile by tile, each in canonical order.
struct TiledSamples {
  std::vector<std::uint32_t> begins;     ///< (T + 1,)
  std::vector<WatermarkSample> samples;  ///< (N,)
  std::vector<std::uint8_t> marks;       ///< (N,) What came with each sample; or none.
  std::vector<std::uint32_t> rows;       ///< (N,) Row of each sample.
};

/// Sorts samples into tiles; keeps its memory from frame to frame.
class CanonicalOrder {
 public:
  /// @param marks      (N,), or none at all: `tiled` has none then.
  /// @param slices     (N,) slice of each sample.
  /// @param tile_of    tile of each slice.
  /// @param num_tiles  greater than any of `tile_of`.
  void sort(const std::vector<WatermarkSample>& samples, const std::vector<std::uint8_t>& marks,
            const std::vector<std::uint16_t>& slices, const std::vector<std::uint16_t>& tile_of,
            int num_tiles, WatermarkOrder order, TiledSamples& tiled);

 private:
  template <WatermarkOrder kOrder>
  void sort_by(const std::vector<WatermarkSample>& samples,
               const std::vector<std::uint16_t>& slices, const std::vector<std::uint16_t>& tile_of,
               std::vector<std::uint32_t>& begins);

  // A key above the row of a sample.
  std::vector<std::uint64_t> items_, other_;
  std::vector<std::uint32_t> seconds_;  // the second field of each sample
};

}  // namespace manip3d
