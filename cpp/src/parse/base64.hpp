#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "parse/json_place.hpp"

namespace manip3d {

/// Encodes base64 (RFC 4648) with padding.
std::string encode_base64(std::span<const std::byte> bytes);

/// Decodes base64 (RFC 4648) of both alphabets, with or without padding.
/// @throws FormatError  (with `place`) the text is not base64.
std::vector<std::byte> decode_base64(const JsonPlace& place, std::string_view text);

}  // namespace manip3d
