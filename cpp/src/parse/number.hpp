#pragma once

#include <charconv>
#include <cmath>
#include <string_view>
#include <system_error>

namespace manip3d {

/// The text after a plus sign, which std::from_chars refuses. What has two signs stays as it is,
/// and is no number.
inline std::string_view without_plus(std::string_view text) {
  if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
  return text;
}

/// Reads a number as std::from_chars does, except that one which is too small for a double is zero.
/// One that is too large is std::errc::result_out_of_range.
inline std::from_chars_result to_double(std::string_view text, double& value) {
  const char* const end = text.data() + text.size();
  std::from_chars_result result = std::from_chars(text.data(), end, value);
  if (result.ec != std::errc::result_out_of_range) return result;
  long double wide = 0.0L;
  bool is_small = false;
  if (std::from_chars(text.data(), end, wide).ec == std::errc()) {
    is_small = std::fabs(wide) < 1.0L;
  } else {  // Beyond a long double, the sign of the exponent decides.
    const std::string_view digits(text.data(), static_cast<std::size_t>(result.ptr - text.data()));
    const std::size_t exponent = digits.find_first_of("eE");
    is_small = exponent != std::string_view::npos && digits.substr(exponent + 1).starts_with('-');
  }
  if (is_small) {
    value = static_cast<double>(wide);
    result.ec = std::errc();
  }
  return result;
}

}  // namespace manip3d
