#pragma once

#include <cstdint>
#include <string_view>

#include "parse/json_place.hpp"

namespace manip3d {

/// An upper bound of the number of values in a JSON text, too large by one at most.
/// @throws FormatError  the nesting is too deep. (nlohmann's parser has no limit of its own.)
std::int64_t count_json_values(std::string_view text, std::int64_t offset);

/// Parses a JSON text.
/// @param offset  Offset of the text in its file, for messages.
/// @throws FormatError  it is not JSON, or a number is beyond double.
JsonPlace::Json parse_json(std::string_view text, std::int64_t offset);

}  // namespace manip3d
