#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "manip3d/authenticate/watermark.hpp"

namespace manip3d {

constexpr std::size_t kRecordEnd = 64;  ///< Bytes of the two tags at the end of a record.
constexpr std::uint32_t kMaxUnitsPerMetre = 1'000'000;
/// Largest float64 coordinate, units: there, float64 has a resolution of 2^-15 units.
constexpr std::int64_t kFarthestUnit = std::int64_t{1} << 37;
constexpr std::size_t kSensorOffset = 12, kSessionOffset = 28;
constexpr std::size_t kSlicesOffset = 94, kTilesOffset = 96;
constexpr std::string_view kRecordMagic = "m3d-wm01";

/// Bytes of a record with this number of slices and tiles.
std::size_t record_size(std::size_t slices, std::size_t tiles);

std::vector<std::uint8_t> header_bytes(const WatermarkHeader& header);

}  // namespace manip3d
