#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/authenticate/watermark.hpp"

/// @file
/// The order of points that embedder and verifier of a watermark both derive from the parts of the
/// points that embedding does not change.
namespace manip3d {

/// The message of one point that the watermark binds: 16 bytes, little-endian.
struct WatermarkSample {
  std::int32_t x, y, z, intensity;

  // Without branches, because neighbours in canonical order often share their first fields.
  friend bool operator==(const WatermarkSample& a, const WatermarkSample& b) {
    return ((a.x ^ b.x) | (a.y ^ b.y) | (a.z ^ b.z) | (a.intensity ^ b.intensity)) == 0;
  }
};

/// Borders of the slices: directions counter-clockwise from the x axis, times 2^28.
class SliceTable {
 public:
  /// @throws InputError  `num_slices` is not in [4, 360].
  explicit SliceTable(int num_slices);

  [[nodiscard]] int size() const { return static_cast<int>(x_.size()); }
  /// Writes the slices of `count` samples, or of `count` points with three coordinates each. (0, 0)
  /// is in slice 0; a border belongs to the slice that follows it counter-clockwise.
  void find(const WatermarkSample* samples, std::size_t count, std::uint16_t* slices) const;
  void find(const float* xyz, std::size_t count, std::uint16_t* slices) const;

 private:
  template <typename Wide, std::size_t kStride, typename Value>
  void find_all(const Value* xy, std::size_t count, std::uint16_t* slices) const;

  std::vector<std::int32_t> x_, y_;     // the direction at which each slice begins
  std::vector<std::uint16_t> guesses_;  // slice at the beginning of each cell of diamond angles
};

/// Counts the points of each slice.
std::vector<std::uint32_t> count_slices(const std::vector<std::uint16_t>& slices, int num_slices);

/// Merges slices until each tile has at least `least` points; returns the tile of each slice.
std::vector<std::uint16_t> merge_slices(const std::vector<std::uint32_t>& counts,
                                        std::uint32_t least, WatermarkMerge merge);

/// Order of the points within a tile: their fields by decreasing priority.
enum class WatermarkOrder : std::uint8_t {
  kHeightFirst,   ///< z, rho^2, x, y, intensity.
  kColumnsFirst,  ///< x, y, intensity, z.
  /// z, x, y, intensity: for samples that are bit patterns of floats, which have no rho^2.
  kPlain,
};

/// Samples of all tiles, tile by tile, each in canonical order.
struct TiledSamples {
  std::vector<std::uint32_t> begins;     ///< (T + 1,) first sample of each tile, and the end.
  std::vector<WatermarkSample> samples;  ///< (N,)
  /// (N,) mark of each sample; empty if sort() was called without marks.
  std::vector<std::uint8_t> marks;
  std::vector<std::uint32_t> rows;  ///< (N,) input row of each sample.
};

/// Sorts samples into tiles. Keeps its memory from frame to frame.
class CanonicalOrder {
 public:
  /// @param marks      (N,) or empty; `tiled` then has no marks either.
  /// @param slices     (N,) slice of each sample.
  /// @param tile_of    tile of each slice.
  /// @param num_tiles  greater than each element of `tile_of`.
  void sort(const std::vector<WatermarkSample>& samples, const std::vector<std::uint8_t>& marks,
            const std::vector<std::uint16_t>& slices, const std::vector<std::uint16_t>& tile_of,
            int num_tiles, WatermarkOrder order, TiledSamples& tiled);

 private:
  template <WatermarkOrder kOrder>
  void sort_by(const std::vector<WatermarkSample>& samples,
               const std::vector<std::uint16_t>& slices, const std::vector<std::uint16_t>& tile_of,
               std::vector<std::uint32_t>& begins);

  // Sort items: a key in the high bits, the row of the sample in the low bits.
  std::vector<std::uint64_t> items_, other_;
  std::vector<std::uint32_t> seconds_;  // the second field of each sample
};

}  // namespace manip3d
