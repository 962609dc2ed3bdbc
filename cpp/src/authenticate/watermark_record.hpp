#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "manip3d/authenticate/watermark.hpp"

namespace manip3d {

constexpr std::size_t kRecordEnd = 64;  ///< Bytes of the two tags behind the record proper.
constexpr std::uint32_t kMostUnitsPerMetre = 1'000'000;
/// Units from the zero of coordinates in float64: a float64 there has 2^-15 units.
constexpr std::int64_t kFarthestUnit = std::int64_t{1} << 37;
constexpr std::size_t kSensorOffset = 12, kSessionOffset = 28;
constexpr std::size_t kSlicesOffset = 94, kTilesOffset = 96;
constexpr std::string_view kRecordMagic = "m3d-wm01";

/// Bytes of a record of so many slices and tiles.
std::size_t record_size(std::size_t slices, std::size_t tiles);

std::vector<std::uint8_t> header_bytes(const WatermarkHeader& header);

}  // namespace manip3d
