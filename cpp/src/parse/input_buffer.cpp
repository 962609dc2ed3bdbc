#include "parse/input_buffer.hpp"

#include <algorithm>
#include <cstring>

namespace manip3d {
namespace {

constexpr std::size_t kBlock = std::size_t{1} << 18;
// Bytes: long enough for a polygon of a million corners.
constexpr std::size_t kLongestLine = std::size_t{32} << 20;
// Largest ratio of the bytes of tables to those of the compressed file. Real meshes have 5 to 30
// with .xz.
constexpr std::uint64_t kMaxTableExpansion = 100;

/// Size of the first block. A small file does not need a whole one; one byte more than its size
/// shows its end immediately.
std::size_t first_block(const ByteSource& source) {
  const auto size = source.remaining();
  return size && *size < kBlock ? static_cast<std::size_t>(*size) + 1 : kBlock;
}

}  // namespace

InputBuffer::InputBuffer(ByteSource& source, Progress progress)
    : source_(source), progress_(std::move(progress)), buffer_(first_block(source)) {}

bool InputBuffer::fill() {
  if (source_ended_) return false;
  if (begin_ > 0) {
    std::memmove(buffer_.data(), buffer_.data() + begin_, end_ - begin_);
    end_ -= begin_;
    begin_ = 0;
  }
  if (end_ == buffer_.size()) buffer_.resize(2 * buffer_.size());
  const std::size_t got = source_.read(buffer_.data() + end_, buffer_.size() - end_);
  end_ += got;
  source_ended_ = got == 0;
  if (progress_ && source_.stored_size() > 0) {
    progress_(std::min(1.0, static_cast<double>(source_.stored_bytes()) /
                                static_cast<double>(source_.stored_size())));
  }
  return got > 0;
}

void InputBuffer::remove_mark(std::string_view& line) const {
  if (line.starts_with("\xEF\xBB\xBF")) line.remove_prefix(3);  // UTF-8
  if (line.starts_with("\xFF\xFE") || line.starts_with("\xFE\xFF")) {
    fail_at_line("expected ASCII or UTF-8, got the byte order mark of UTF-16");
  }
}

// The line end: CR if the first block contains some and no LF (text of early Macintosh systems),
// else LF.
char InputBuffer::find_line_end() {
  std::size_t searched = 0;
  // is_cut: the block ends between a CR and what may be its LF
  bool has_cr = false, is_cut = false;
  do {
    const std::string_view seen(buffer_.data() + begin_, end_ - begin_);
    if (seen.find('\n', searched) != std::string_view::npos) return '\n';
    has_cr = has_cr || seen.find('\r', searched) != std::string_view::npos;
    searched = seen.size();
    is_cut = seen.ends_with('\r');
  } while (searched < (has_cr && !is_cut ? kBlock : kLongestLine) && fill());
  return has_cr ? '\r' : '\n';
}

bool InputBuffer::next_line(std::string_view& line) {
  if (line_end_ == '\0') line_end_ = find_line_end();
  std::size_t searched = 0;
  const char* end_of_line = nullptr;
  while (true) {
    const char* start = buffer_.data() + begin_;
    end_of_line = static_cast<const char*>(
        std::memchr(start + searched, line_end_, end_ - begin_ - searched));
    if (end_of_line != nullptr) break;
    searched = end_ - begin_;
    if (searched > kLongestLine) {
      throw FormatError::at_line(lines_read_ + 1,
                                 "line longer than " + std::to_string(kLongestLine) + " bytes");
    }
    if (!fill()) break;
  }
  if (end_of_line == nullptr && begin_ == end_) return false;
  const char* start = buffer_.data() + begin_;
  const std::size_t size =
      end_of_line != nullptr ? static_cast<std::size_t>(end_of_line - start) : end_ - begin_;
  const std::size_t taken = size + (end_of_line != nullptr ? 1 : 0);
  line = {start, size};
  if (line.ends_with('\r')) line.remove_suffix(1);
  begin_ += taken;
  offset_ += static_cast<std::int64_t>(taken);
  line_ = ++lines_read_;
  if (line_ == 1) remove_mark(line);
  return true;
}

bool InputBuffer::next_joined_line(std::string_view& line) {
  if (!next_line(line)) return false;
  if (!line.ends_with('\\') || line.starts_with('#')) return true;
  const std::int64_t first = line_;
  joined_.clear();
  bool more = true;
  while (more) {
    const bool continued = line.ends_with('\\');
    if (continued) line.remove_suffix(1);
    joined_ += line;
    joined_ += ' ';
    if (joined_.size() > kLongestLine) {
      throw FormatError::at_line(first,
                                 "line longer than " + std::to_string(kLongestLine) + " bytes");
    }
    more = continued && next_line(line);
  }
  line_ = first;
  line = joined_;
  return true;
}

const char* InputBuffer::bytes(std::size_t size, const char* what) {
  while (end_ - begin_ < size) {
    if (fill()) continue;
    throw FormatError::at_byte(offset_ + static_cast<std::int64_t>(end_ - begin_),
                               std::string("file ends within ") + what);
  }
  const char* start = buffer_.data() + begin_;
  begin_ += size;
  offset_ += static_cast<std::int64_t>(size);
  return start;
}

std::string_view InputBuffer::peek(std::size_t size) {
  while (end_ - begin_ < size && fill()) {
  }
  return {buffer_.data() + begin_, std::min(size, end_ - begin_)};
}

std::optional<std::uint64_t> InputBuffer::remaining() const {
  const auto unread = source_.remaining();
  return unread ? std::optional(*unread + (end_ - begin_)) : std::nullopt;
}

std::int64_t InputBuffer::checked_claim(std::int64_t count, std::int64_t least_bytes_each,
                                        const char* what,
                                        const FormatError::Position& position) const {
  if (count < 0) {
    throw FormatError(std::string(what) + ": expected a count >= 0, got " + std::to_string(count),
                      position);
  }
  const auto bytes_left = remaining();
  if (!bytes_left) return 0;
  const std::uint64_t fit =
      *bytes_left / static_cast<std::uint64_t>(std::max<std::int64_t>(1, least_bytes_each));
  if (static_cast<std::uint64_t>(count) > fit) {
    throw FormatError(std::to_string(count) + " " + what + " claimed, but at most " +
                          std::to_string(fit) + " fit into the rest of the file",
                      position);
  }
  return count;
}

void InputBuffer::check_expansion(std::uint64_t table_bytes) const {
  if (source_.expansion_allowed() || table_bytes <= kFreeExpansion) return;
  if (table_bytes / kMaxTableExpansion <= source_.stored_size()) return;
  throw FormatError::at_byte(offset_, "compressed data make tables more than " +
                                          std::to_string(kMaxTableExpansion) +
                                          " times as large; set max_bytes to read them");
}

}  // namespace manip3d
