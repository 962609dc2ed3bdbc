#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/files/byte_source.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Reads lines and blocks of a ByteSource through a buffer that is as large as the longest line. It
/// knows the position for error messages.
class InputBuffer {
 public:
  explicit InputBuffer(ByteSource& source, Progress progress = {});

  /// Reads the next line, without its end (LF, CRLF, or CR if the file starts with CRs and no LF);
  /// returns false at the end. The line is valid until the next call. A byte order mark at the
  /// beginning of the file is left out.
  /// @throws FormatError  the byte order mark is that of UTF-16.
  bool next_line(std::string_view& line);
  /// Like next_line(), but joins lines that end in a backslash with the next line. Lines that start
  /// with '#' are not joined.
  bool next_joined_line(std::string_view& line);
  /// From now on lines end with CR, because LFs may be binary data.
  void end_lines_with_cr() { line_end_ = '\r'; }
  /// Reads exactly `size` bytes, valid until the next call.
  /// @throws FormatError  the stream ends before that.
  const char* bytes(std::size_t size, const char* what);
  /// Returns the next bytes, at most `size`, without consuming them.
  std::string_view peek(std::size_t size);
  bool at_end() { return peek(1).empty(); }

  /// 1-based number of the last line (of the first one, if lines were joined).
  [[nodiscard]] std::int64_t line() const { return line_; }
  /// Offset of the next byte.
  [[nodiscard]] std::int64_t offset() const { return offset_; }
  /// Upper bound of the bytes still to come; empty: unknown.
  [[nodiscard]] std::optional<std::uint64_t> remaining() const;

  [[noreturn]] void fail_at_line(const std::string& reason) const {
    throw FormatError::at_line(line_, reason);
  }

  /// Refuses a count of elements that need more bytes than can still come.
  /// @return  Number of elements to reserve: `count`, or 0 if it is unknown whether the bytes are
  ///          there.
  std::int64_t checked_claim(std::int64_t count, std::int64_t least_bytes_each, const char* what,
                             const FormatError::Position& position) const;

  /// Limits the growth of tables: a small compressed file must not become huge tables.
  void check_expansion(std::uint64_t table_bytes) const;

 private:
  void remove_mark(std::string_view& line) const;
  char find_line_end();
  bool fill();  // reads more bytes behind the unread ones; false at the end

  ByteSource& source_;
  Progress progress_;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;  // unread bytes
  bool source_ended_ = false;
  char line_end_ = '\0';  // '\n' or '\r'; '\0': no line was read yet
  std::int64_t offset_ = 0;
  std::int64_t line_ = 0;
  std::int64_t lines_read_ = 0;
  std::string joined_;
};

}  // namespace manip3d
