#include "parse/json_text.hpp"

#include <algorithm>
#include <string>

namespace manip3d {
namespace {

constexpr int kMaxDepth = 64;  // levels of nesting; real files have fewer than 20

}  // namespace

std::int64_t count_json_values(std::string_view text, std::int64_t offset) {
  std::int64_t num_values = 0;
  int depth = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '[' || c == '{') {
      if (++depth > kMaxDepth) {
        throw FormatError::at_byte(offset + static_cast<std::int64_t>(i),
                                   "JSON: nested deeper than " + std::to_string(kMaxDepth));
      }
    } else if (c == ']' || c == '}') {
      --depth;
    }
    if (!in_string && (c == ',' || c == '[' || c == '{')) ++num_values;
  }
  return num_values;
}

JsonPlace::Json parse_json(std::string_view text, std::int64_t offset) {
  try {
    return JsonPlace::Json::parse(text.begin(), text.end());
  } catch (const JsonPlace::Json::parse_error& error) {
    const std::int64_t at = std::max<std::int64_t>(static_cast<std::int64_t>(error.byte) - 1, 0);
    throw FormatError::at_byte(offset + at, "not JSON: the syntax breaks here");
  } catch (const JsonPlace::Json::exception&) {  // a number beyond double
    throw FormatError::at_byte(offset, "JSON: a number is out of range");
  }
}

}  // namespace manip3d
