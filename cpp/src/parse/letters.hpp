#pragma once

#include <algorithm>
#include <string_view>

namespace manip3d {

/// ASCII letters are compared in lower case; `lower` has no capitals.
inline bool is_same_in_any_case(std::string_view text, std::string_view lower) {
  const auto same = [](char a, char b) {
    return (a >= 'A' && a <= 'Z' ? static_cast<char>(a - 'A' + 'a') : a) == b;
  };
  return std::equal(text.begin(), text.end(), lower.begin(), lower.end(), same);
}

inline bool starts_with_in_any_case(std::string_view text, std::string_view lower) {
  return is_same_in_any_case(text.substr(0, lower.size()), lower);
}

}  // namespace manip3d
