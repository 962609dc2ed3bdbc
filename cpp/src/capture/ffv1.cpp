#include "capture/ffv1.hpp"

#include <algorithm>

namespace manip3d {
namespace {

/// Counts the slices of a packet if each ends with a footer of `footer` bytes, whose first three
/// are the length of the slice (RFC 9043, section 4.9).
int count_slices(std::span<const std::byte> packet, std::size_t footer) {
  int count = 0;
  while (packet.size() > footer && count <= kMaxFfv1Slices) {
    const std::byte* end = packet.data() + packet.size() - footer;
    const std::size_t length = std::to_integer<std::size_t>(end[0]) << 16 |
                               std::to_integer<std::size_t>(end[1]) << 8 |
                               std::to_integer<std::size_t>(end[2]);
    if (length + footer > packet.size()) break;
    packet = packet.first(packet.size() - length - footer);
    ++count;
  }
  return count;
}

}  // namespace

int count_ffv1_slices(std::span<const std::byte> packet) {
  return std::max(count_slices(packet, 8), count_slices(packet, 3));
}

int ffv1_version(std::span<const std::byte> header) {
  if (header.size() < 2) return 0;
  std::size_t next = 0;
  const auto byte = [&] {
    return next < header.size() ? std::to_integer<unsigned>(header[next++]) : 0U;
  };
  // RFC 9043, section 3.8.1. Each bit of the first number has its own state, which still has its
  // initial value of one half.
  unsigned low = byte() << 8;
  low |= byte();
  unsigned range = 0xff00;
  const auto bit = [&] {
    const unsigned one = range * 128 >> 8;
    range -= one;
    const bool is_set = low >= range;
    if (is_set) {
      low -= range;
      range = one;
    }
    if (range < 0x100) {
      range <<= 8;
      low = (low << 8) + byte();
    }
    return is_set;
  };
  if (bit()) return 0;
  int digits = 0;
  while (digits < 8 && bit()) ++digits;
  int version = 1;
  while (digits-- > 0) version = 2 * version + (bit() ? 1 : 0);
  return version;
}

}  // namespace manip3d
