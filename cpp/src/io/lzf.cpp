#include "io/lzf.hpp"

#include <algorithm>
#include <array>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kLongestRun = 32;
constexpr std::size_t kLongestCopy = 264;
constexpr std::size_t kFarthest = 8192;
constexpr std::size_t kShortestCopy = 3;

std::size_t byte(char c) { return static_cast<unsigned char>(c); }

void append_run(std::span<const char> run, std::vector<char>& packed) {
  while (!run.empty()) {
    const std::size_t size = std::min(run.size(), kLongestRun);
    packed.push_back(static_cast<char>(size - 1));
    packed.insert(packed.end(), run.begin(), run.begin() + static_cast<std::ptrdiff_t>(size));
    run = run.subspan(size);
  }
}

void append_copy(std::size_t distance, std::size_t length, std::vector<char>& packed) {
  const std::size_t far = distance - 1;
  const std::size_t long_by = length - 2;
  constexpr std::size_t kInline = 7;
  packed.push_back(static_cast<char>(std::min(long_by, kInline) << 5 | far >> 8));
  if (long_by >= kInline) packed.push_back(static_cast<char>(long_by - kInline));
  packed.push_back(static_cast<char>(far & 0xFF));
}

}  // namespace

std::vector<char> lzf_decompress(std::span<const char> packed, std::size_t size,
                                 std::int64_t offset) {
  std::vector<char> data;
  data.reserve(size);
  std::size_t at = 0;
  const auto fail = [&](const std::string& reason) {
    throw FormatError::at_byte(offset + static_cast<std::int64_t>(at), "LZF: " + reason);
  };
  while (at < packed.size()) {
    const std::size_t control = byte(packed[at++]);
    if (control < kLongestRun) {
      const std::size_t length = control + 1;
      if (length > packed.size() - at) fail("the data end within a run");
      if (length > size - data.size()) fail("more bytes than expected");
      data.insert(data.end(), packed.begin() + static_cast<std::ptrdiff_t>(at),
                  packed.begin() + static_cast<std::ptrdiff_t>(at + length));
      at += length;
      continue;
    }
    std::size_t length = (control >> 5) + 2;
    const bool is_long = length == 9;
    if (packed.size() - at < (is_long ? 2U : 1U)) fail("the data end within a copy");
    if (is_long) length += byte(packed[at++]);
    const std::size_t distance = ((control & 0x1F) << 8) + byte(packed[at++]) + 1;
    if (distance > data.size()) fail("a copy from before the beginning");
    if (length > size - data.size()) fail("more bytes than expected");
    for (std::size_t i = 0; i < length; ++i) data.push_back(data[data.size() - distance]);
  }
  if (data.size() != size) {
    fail("expected " + std::to_string(size) + " bytes, got " + std::to_string(data.size()));
  }
  return data;
}

std::vector<char> lzf_compress(std::span<const char> data) {
  constexpr std::size_t kBits = 14;
  // The largest prime below 2^32 divided by the golden ratio: its multiples spread similar words
  // [Knuth, The Art of Computer Programming, vol. 3, section 6.4].
  constexpr std::size_t kSpread = 2654435761U;
  // place + 1 of the latest occurrence of each hash
  std::vector<std::size_t> last(std::size_t{1} << kBits, 0);
  std::vector<char> packed;
  std::size_t run = 0;  // beginning of the bytes that no copy covers
  std::size_t at = 0;
  while (at + kShortestCopy <= data.size()) {
    const std::size_t word = byte(data[at]) << 16 | byte(data[at + 1]) << 8 | byte(data[at + 2]);
    std::size_t& place = last[(word * kSpread >> 8) & ((std::size_t{1} << kBits) - 1)];
    const std::size_t found = place;
    place = at + 1;
    std::size_t length = 0;
    if (found > 0 && at + 1 - found <= kFarthest) {
      const std::size_t most = std::min(kLongestCopy, data.size() - at);
      while (length < most && data[found - 1 + length] == data[at + length]) ++length;
    }
    if (length < kShortestCopy) {
      ++at;
      continue;
    }
    append_run(data.subspan(run, at - run), packed);
    append_copy(at + 1 - found, length, packed);
    at += length;
    run = at;
  }
  append_run(data.subspan(run), packed);
  return packed;
}

}  // namespace manip3d
