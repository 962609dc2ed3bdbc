#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/authenticate/watermark.hpp"
#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// The fragile watermark as printed in the dissertation (section 7.3.1). Its bits do not depend on
/// the content: anybody can move points and write the same bits again, so that it proves nothing.
namespace manip3d {

enum class PaperEmbedding : std::uint8_t {
  kLbm,         ///< Lowest bits of x, y and z; the points are ordered with these bits cleared.
  kQimCell,     ///< z at a quarter or three quarters of a cell of 2.5 mm.
  kQimPrinted,  ///< Equations 7.1 to 7.3; the points are ordered without z.
};

/// Options of the watermark of section 7.3.1.
struct PaperOptions {
  PaperEmbedding embedding = PaperEmbedding::kLbm;
  int slices = 36;        ///< Sectors of equal azimuth around the scanner.
  int block_bits = 1000;  ///< M, bits of a block; slices with fewer points are merged.
  WatermarkMerge merge = WatermarkMerge::kAdjacent;
  std::uint64_t key_2 = 0;  ///< Assigns blocks to slices, and bits of blocks to points.
  std::uint32_t frame = 0;  ///< Number of the frame in its stream; part of the assignment.
};

/// Metadata that the receiver gets over a secured channel.
struct PaperMetadata {
  std::vector<std::uint16_t> tile_of;  ///< Tile of each slice.
  std::vector<std::uint32_t> counts;   ///< Points of each tile.
};

struct PaperMarked {
  Points points;  ///< The points in their input order.
  PaperMetadata metadata;
};

/// @param blocks  slices x block_bits values, 0 or 1: the columns of the watermark image.
/// @throws InputError  no points, points off the grid of 1 mm, an option or a bit out of range.
PaperMarked embed_paper(const PointsView& points, std::span<const std::uint8_t> blocks,
                        const PaperOptions& options);

struct PaperComparison {
  std::vector<std::int64_t> mismatches;  ///< By tile: number of points whose bits differ.
  /// By tile: number of bits of the block that differ after the AND of their copies.
  std::vector<std::int64_t> and_mismatches;
  std::vector<std::uint32_t> counts;  ///< By tile: number of points found.
  std::vector<std::int32_t> rows;     ///< Row numbers of the points whose bits differ, ascending.
};

/// Extracts the bits (equation 7.4 with the absolute value) and compares them with `blocks`.
/// @throws InputError  an option out of range, or metadata that contradict them.
PaperComparison compare_paper(const PointsView& points, std::span<const std::uint8_t> blocks,
                              const PaperMetadata& metadata, const PaperOptions& options);

}  // namespace manip3d
