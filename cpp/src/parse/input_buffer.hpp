#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/io/byte_source.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Lines and blocks out of a ByteSource, through one buffer that stays as large as the longest
/// line. Knows the position for error messages.
class InputBuffer {
 public:
  explicit InputBuffer(ByteSource& source, Progress progress = {});

  /// The next line without its end (LF, CRLF, or CR in a file that starts with CRs and no LF);
  /// false at the end. Valid until the next call. A byte order mark before the first one is left
  /// out.
  /// @throws FormatError  the mark is that of UTF-16.
  bool next_line(std::string_view& line);
  /// Like next_line, but for lines ending in a backslash, which the next line continues.
  /// Lines starting with '#' do not continue.
  bool next_joined_line(std::string_view& line);
  /// From here on, lines end in CR, whatever the file starts with: LFs may be binary data.
  void end_lines_with_cr() { line_end_ = '\r'; }
  /// Exactly `size` bytes, valid until the next call.
  /// @throws FormatError  the stream ends before.
  const char* bytes(std::size_t size, const char* what);
  /// The next bytes, at most `size`; does not move on.
  std::string_view peek(std::size_t size);
  bool at_end() { return peek(1).empty(); }

  /// 1-based number of the line that was returned last (its first line, when joined).
  [[nodiscard]] std::int64_t line() const { return line_; }
  /// Offset of the next byte.
  [[nodiscard]] std::int64_t offset() const { return offset_; }
  /// Upper bound on the bytes still to come, if known.
  [[nodiscard]] std::optional<std::uint64_t> remaining() const;

  [[noreturn]] void fail_at_line(const std::string& reason) const {
    throw FormatError::at_line(line_, reason);
  }

  /// Refuses a count that needs more bytes than can still come.
  /// @return how many to reserve: `count`, or 0 where the bytes are not known to be there.
  std::int64_t checked_claim(std::int64_t count, std::int64_t least_bytes_each, const char* what,
                             const FormatError::Position& position) const;

  /// Called as tables grow: a small compressed file may not become huge tables either.
  void check_expansion(std::uint64_t table_bytes) const;

 private:
  void remove_mark(std::string_view& line) const;
  char find_line_end();
  bool fill();  // more bytes behind the unread ones; false at the end

  ByteSource& source_;
  Progress progress_;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;  // unread bytes
  bool source_ended_ = false;
  char line_end_ = '\0';  // '\n' or '\r'; '\0': no line was asked for yet
  std::int64_t offset_ = 0;
  std::int64_t line_ = 0;
  std::int64_t lines_read_ = 0;
  std::string joined_;
};

}  // namespace manip3d
