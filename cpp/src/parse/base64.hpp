#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "parse/json_place.hpp"

namespace manip3d {

/// RFC 4648, with padding.
std::string encode_base64(std::span<const std::byte> bytes);

/// RFC 4648, both alphabets, with or without padding.
/// @throws FormatError  at `place`.
std::vector<std::byte> decode_base64(const JsonPlace& place, std::string_view text);

}  // namespace manip3d
