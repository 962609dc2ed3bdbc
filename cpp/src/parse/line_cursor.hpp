#pragma once

#include <charconv>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>

#include "manip3d/error.hpp"
#include "parse/number.hpp"

namespace manip3d {

/// Reads words and numbers of a line from left to right; errors have the line's number.
class LineCursor {
 public:
  LineCursor(std::string_view line, std::int64_t line_number)
      : at_(line.data()), end_(line.data() + line.size()), line_(line_number) {}

  /// Skips blanks; returns true if only a comment (`# ...`) or nothing is left.
  bool at_end() {
    skip_blanks();
    return at_ == end_ || *at_ == '#';
  }

  std::string_view word() {
    skip_blanks();
    const char* start = at_;
    while (at_ < end_ && !is_blank(*at_)) ++at_;
    return {start, static_cast<std::size_t>(at_ - start)};
  }

  /// The rest of the line without leading and trailing blanks.
  std::string_view rest() {
    skip_blanks();
    const char* last = end_;
    while (last > at_ && is_blank(last[-1])) --last;
    const std::string_view text(at_, static_cast<std::size_t>(last - at_));
    at_ = end_;
    return text;
  }

  /// Takes a word that stands for NaN, such as nan, -nan(ind) or NaN; false: the next is another.
  bool take_nan() { return take_not_finite('n'); }

  /// Takes a word that stands for an infinity, such as inf or -Infinity; false: the next is
  /// another.
  bool take_infinity() { return take_not_finite('i'); }

  /// Reads a finite number. Numbers are separated by blanks, so that a comma within one is a
  /// decimal comma.
  double number(const char* what) {
    skip_blanks();
    const std::string_view text = without_plus(unread());
    double value = 0.0;
    const auto [stop, error] = to_double(text, value);
    if (stop < end_ && *stop == ',') return with_decimal_comma(text, what);
    if (error == std::errc::result_out_of_range) fail(what, "a number that fits a double");
    if (error != std::errc() || (stop < end_ && !is_blank(*stop)) || !std::isfinite(value)) {
      fail(what, "a finite number");
    }
    at_ = stop;
    return value;
  }

  /// Reads an integer of 64 bits.
  std::int64_t integer(const char* what) {
    skip_blanks();
    std::int64_t value = 0;
    const auto [stop, error] = std::from_chars(without_plus(unread()).data(), end_, value);
    if (error != std::errc() || (stop < end_ && !is_blank(*stop))) fail(what, "an integer");
    at_ = stop;
    return value;
  }

  /// The unread text, for hand-written loops over frequent syntax.
  [[nodiscard]] const char* position() const { return at_; }
  [[nodiscard]] const char* end() const { return end_; }
  void move_to(const char* position) { at_ = position; }

  [[nodiscard]] std::int64_t line() const { return line_; }

  /// Throws "<what>: expected <expected>, got '<next word>'".
  [[noreturn]] void fail(const char* what, const char* expected) {
    constexpr std::size_t kShown = 40;
    std::string got;
    for (const char c : word().substr(0, kShown)) {
      const bool printable = c >= ' ' && c <= '~';
      got += printable ? c : '?';
    }
    throw FormatError::at_line(line_, std::string(what) + ": expected " + expected + ", got " +
                                          (got.empty() ? "the end of the line" : "'" + got + "'"));
  }

  static bool is_blank(char c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f';
  }

 private:
  [[nodiscard]] std::string_view unread() const {
    return {at_, static_cast<std::size_t>(end_ - at_)};
  }

  void skip_blanks() {
    while (at_ < end_ && is_blank(*at_)) ++at_;
  }

  /// Takes a word for a value that is not finite and whose name begins with this small letter.
  bool take_not_finite(char letter) {
    skip_blanks();
    const std::string_view text = without_plus(unread());
    const std::string_view name = text.starts_with('-') ? text.substr(1) : text;
    if (!name.starts_with(letter) && !name.starts_with(static_cast<char>(letter - 'a' + 'A'))) {
      return false;
    }
    double value = 0.0;
    const auto [stop, error] = std::from_chars(text.data(), end_, value);
    if (error != std::errc() || (stop < end_ && !is_blank(*stop)) || std::isfinite(value)) {
      return false;
    }
    at_ = stop;
    return true;
  }

  double with_decimal_comma(std::string_view text, const char* what) {
    const char* stop = text.data();
    while (stop < end_ && !is_blank(*stop)) ++stop;
    std::string digits(text.data(), stop);
    const std::size_t comma = digits.find(',');
    // Refuses "1,000.5", and a comma between numbers, as in "1, 2, 3" and "1,2,3".
    if (digits.find('.') != std::string::npos || comma + 1 == digits.size()) {
      fail(what, "a finite number");
    }
    digits[comma] = '.';
    double value = 0.0;
    const auto [last, error] = to_double(digits, value);
    if (error != std::errc() || last != digits.data() + digits.size()) {
      fail(what, "a finite number");
    }
    at_ = stop;
    return value;
  }

  const char* at_;
  const char* end_;
  std::int64_t line_;
};

}  // namespace manip3d
