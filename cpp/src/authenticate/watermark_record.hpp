#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/authenticate/watermark.hpp"

namespace manip3d {

constexpr std::size_t kRecordEnd = 64;  ///< Bytes of the two tags behind the record proper.
constexpr std::size_t kSensorOffset = 12, kSessionOffset = 28;

std::vector<std::uint8_t> header_bytes(const WatermarkHeader& header);

}  // namespace manip3d
