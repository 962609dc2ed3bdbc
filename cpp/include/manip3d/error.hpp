#pragma once

#include <array>
#include <charconv>
#include <concepts>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

/// @file
/// The three errors that every manip3d function may throw. The bindings turn them into
/// `manip3d.Error` and its subclasses.
namespace manip3d {

/// Shortest text that reads back as exactly this number. Error messages show numbers so, because a
/// fixed number of decimals would hide what is wrong with them.
template <std::floating_point Number>
[[nodiscard]] std::string number_text(Number value) {
  std::array<char, 32> digits;  // -2.2250738585072014e-308 is the longest
  return {digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr};
}

/// Root of all errors that manip3d throws on purpose.
class Error : public std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A bad argument. The message names the argument, the expected value and the value received.
class InputError : public Error {
  using Error::Error;
};

/// An unreadable file. Carries the position at which reading stopped.
class FormatError : public Error {
 public:
  struct Position {
    std::optional<std::int64_t> line;         ///< 1-based line of a text file.
    std::optional<std::int64_t> byte_offset;  ///< 0-based offset into the uncompressed bytes.
  };

  FormatError(std::string reason, Position position)
      : Error(describe("", reason, position)), reason_(std::move(reason)), position_(position) {}

  /// Returns a copy of this error whose message begins with the name of the file.
  [[nodiscard]] FormatError in_file(const std::string& file) const {
    FormatError named(*this);
    static_cast<Error&>(named) = Error(describe(file, reason_, position_));
    named.file_ = file;
    return named;
  }

  static FormatError at_line(std::int64_t line, std::string reason) {
    return {std::move(reason), Position{line, std::nullopt}};
  }
  static FormatError at_byte(std::int64_t byte_offset, std::string reason) {
    return {std::move(reason), Position{std::nullopt, byte_offset}};
  }

  [[nodiscard]] const std::string& file() const { return file_; }
  [[nodiscard]] const std::string& reason() const { return reason_; }
  [[nodiscard]] const Position& position() const { return position_; }

 private:
  static std::string describe(const std::string& file, const std::string& reason,
                              const Position& position) {
    std::string text;
    if (!file.empty()) text += file + ": ";
    if (position.line) text += "line " + std::to_string(*position.line) + ": ";
    if (position.byte_offset) text += "byte " + std::to_string(*position.byte_offset) + ": ";
    return text + reason;
  }

  std::string file_;
  std::string reason_;
  Position position_;
};

/// A sensor that is absent, lost or misbehaves.
class DeviceError : public Error {
  using Error::Error;
};

}  // namespace manip3d
