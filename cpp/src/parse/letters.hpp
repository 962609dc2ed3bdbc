#pragma once

#include <algorithm>
#include <iterator>
#include <string>
#include <string_view>

namespace manip3d {

/// Is it one of 0 to 9, in every locale?
inline bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// Converts ASCII letters only, in every locale.
inline char lower_case(char c) {
  return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
}

inline std::string lower_case(std::string_view text) {
  std::string lower;
  lower.reserve(text.size());
  std::transform(text.begin(), text.end(), std::back_inserter(lower),
                 [](char c) { return lower_case(c); });
  return lower;
}

/// Compares with ASCII letters of `text` in lower case; `lower` must have no capitals.
inline bool is_same_in_any_case(std::string_view text, std::string_view lower) {
  const auto same = [](char a, char b) { return lower_case(a) == b; };
  return std::equal(text.begin(), text.end(), lower.begin(), lower.end(), same);
}

inline bool starts_with_in_any_case(std::string_view text, std::string_view lower) {
  return is_same_in_any_case(text.substr(0, lower.size()), lower);
}

}  // namespace manip3d
