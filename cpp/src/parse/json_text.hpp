#pragma once

#include <cstdint>
#include <string_view>

#include "parse/json_place.hpp"

namespace manip3d {

/// An upper bound, up to one, on the number of values in a JSON text.
/// @throws FormatError  nested too deeply to be walked; nlohmann's parser itself takes any depth.
std::int64_t count_json_values(std::string_view text, std::int64_t offset);

/// The value of a JSON text.
/// @param offset  of the text in its file, for messages.
/// @throws FormatError  not JSON, or a number that no double holds.
JsonPlace::Json parse_json(std::string_view text, std::int64_t offset);

}  // namespace manip3d
