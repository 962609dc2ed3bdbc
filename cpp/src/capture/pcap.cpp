#include "manip3d/capture/pcap.hpp"

#include <arpa/inet.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "manip3d/error.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {
namespace {

using ByteSpan = std::span<const std::byte>;

constexpr std::size_t kLargestRecord = std::size_t{1} << 18;  // libpcap's limit

enum LinkType : std::uint32_t {
  kBsdLoopback = 0,
  kEthernet = 1,
  kRawBsd = 12,
  kRawOpenBsd = 14,
  kRaw = 101,
  kOpenBsdLoopback = 108,
  kLinuxCooked = 113,
  kRawIpv4 = 228,
  kRawIpv6 = 229,
  kLinuxCooked2 = 276
};

std::uint32_t big16(ByteSpan bytes, std::size_t at) {
  return std::to_integer<std::uint32_t>(bytes[at]) << 8 |
         std::to_integer<std::uint32_t>(bytes[at + 1]);
}

// The bytes from `from` on; none if there are fewer.
std::optional<ByteSpan> after(ByteSpan bytes, std::size_t from) {
  if (bytes.size() < from) return std::nullopt;
  return bytes.subspan(from);
}

enum class Layer : std::uint8_t { kIp, kOther, kCut };
struct Network {
  Layer layer = Layer::kOther;
  ByteSpan bytes;
};

Network network_at(ByteSpan frame, std::size_t header, std::size_t type_at) {
  constexpr std::uint32_t kIpv4 = 0x0800, kIpv6 = 0x86DD;
  // VLAN tags: inner ones, outer ones by IEEE 802.1ad, and outer ones of older switches.
  constexpr std::uint32_t kTag = 0x8100, kOuterTag = 0x88A8, kOlderOuterTag = 0x9100;
  constexpr int kMaxTags = 4;
  if (frame.size() < header) return {Layer::kCut, {}};
  std::uint32_t type = big16(frame, type_at);
  const auto is_tag = [&] { return type == kTag || type == kOuterTag || type == kOlderOuterTag; };
  for (int tags = 0; tags < kMaxTags && is_tag(); ++tags) {
    if (frame.size() < header + 4) return {Layer::kCut, {}};
    type = big16(frame, header + 2);
    header += 4;
  }
  if (type != kIpv4 && type != kIpv6) return {};
  return {Layer::kIp, frame.subspan(header)};
}

Network network_layer(ByteSpan frame, std::uint32_t link) {
  switch (link) {
    case kEthernet:
      return network_at(frame, 14, 12);
    case kLinuxCooked:
      return network_at(frame, 16, 14);
    case kLinuxCooked2:
      return network_at(frame, 20, 0);
    case kBsdLoopback:
    case kOpenBsdLoopback: {
      // The numbers of address families differ between systems; the IP version is used instead.
      const auto bytes = after(frame, 4);
      return bytes ? Network{Layer::kIp, *bytes} : Network{Layer::kCut, {}};
    }
    case kRaw:
    case kRawBsd:
    case kRawOpenBsd:
    case kRawIpv4:
    case kRawIpv6:
      return {Layer::kIp, frame};
    default:
      return {};
  }
}

enum class Found : std::uint8_t { kUdp, kOther, kFragment, kCut };

struct Datagram {
  UdpSender sender;
  ByteSpan payload;
};

void set_address(ByteSpan bytes, UdpSender& sender) {
  std::copy(bytes.begin(), bytes.end(), sender.address.begin());
  sender.is_ipv6 = bytes.size() == sender.address.size();
}

Found udp_of(ByteSpan segment, Datagram& datagram) {
  constexpr std::size_t kHeader = 8;
  if (segment.size() < kHeader) return Found::kCut;
  const std::size_t length = big16(segment, 4);
  if (length < kHeader || length > segment.size()) return Found::kCut;
  datagram.sender.destination_port = static_cast<std::uint16_t>(big16(segment, 2));
  datagram.payload = segment.subspan(kHeader, length - kHeader);
  return Found::kUdp;
}

Found ipv4_of(ByteSpan packet, Datagram& datagram) {
  constexpr std::uint32_t kUdp = 17, kMoreFragments = 0x2000, kOffset = 0x1FFF;
  constexpr std::size_t kMinHeader = 20;
  if (packet.size() < kMinHeader) return Found::kCut;
  const std::size_t header = 4 * (std::to_integer<std::size_t>(packet[0]) & 0xF);
  const std::size_t total = big16(packet, 2);
  if (header < kMinHeader || total < header || total > packet.size()) return Found::kCut;
  if (std::to_integer<std::uint32_t>(packet[9]) != kUdp) return Found::kOther;
  if ((big16(packet, 6) & (kMoreFragments | kOffset)) != 0) return Found::kFragment;
  set_address(packet.subspan(12, 4), datagram.sender);
  return udp_of(packet.subspan(header, total - header), datagram);
}

Found ipv6_of(ByteSpan packet, Datagram& datagram) {
  constexpr std::uint32_t kUdp = 17, kFragmentHeader = 44;
  constexpr std::size_t kHeader = 40;
  if (packet.size() < kHeader) return Found::kCut;
  const std::size_t length = big16(packet, 4);
  if (length > packet.size() - kHeader) return Found::kCut;
  const auto next = std::to_integer<std::uint32_t>(packet[6]);
  if (next == kFragmentHeader) return Found::kFragment;
  if (next != kUdp) return Found::kOther;
  set_address(packet.subspan(8, 16), datagram.sender);
  return udp_of(packet.subspan(kHeader, length), datagram);
}

Found datagram_of(ByteSpan frame, std::uint32_t link, Datagram& datagram) {
  const Network network = network_layer(frame, link);
  if (network.layer == Layer::kCut) return Found::kCut;
  if (network.layer == Layer::kOther) return Found::kOther;
  if (network.bytes.empty()) return Found::kCut;
  const auto version = std::to_integer<std::uint32_t>(network.bytes[0]) >> 4;
  if (version == 4) return ipv4_of(network.bytes, datagram);
  if (version == 6) return ipv6_of(network.bytes, datagram);
  return Found::kOther;
}

}  // namespace

std::string UdpSender::address_text() const {
  std::array<char, INET6_ADDRSTRLEN> text{};
  inet_ntop(is_ipv6 ? AF_INET6 : AF_INET, address.data(), text.data(), text.size());
  return text.data();
}

std::string UdpSender::text() const {
  const std::string host = address_text();
  return (is_ipv6 ? '[' + host + ']' : host) + ':' + std::to_string(destination_port);
}

// The records of a file in either format.
class PcapReader::Records {
 public:
  struct Record {
    std::optional<std::int64_t> time_ns;  // since 1970; empty: unknown
    std::uint32_t link = 0;
    bool is_whole = false;
    ByteSpan bytes;
  };

  explicit Records(ByteSource& source) : input_(source) {
    const std::string_view head = input_.peek(4);
    if (head.size() < 4) throw FormatError::at_byte(0, "expected a pcap or pcapng file");
    std::uint32_t magic = 0;
    for (std::size_t i = 4; i-- > 0;) magic = magic << 8 | static_cast<unsigned char>(head[i]);
    if (magic == kSection) {
      is_ng_ = true;
    } else {
      read_header(magic);
    }
  }

  bool next(Record& record) { return is_ng_ ? next_ng(record) : next_classic(record); }

 private:
  static constexpr std::uint32_t kMicroseconds = 0xA1B2C3D4, kNanoseconds = 0xA1B23C4D;
  static constexpr std::int64_t kSecond = 1'000'000'000;  // in nanoseconds
  // Types of blocks of pcapng; the first one is that of a section header.
  static constexpr std::uint32_t kSection = 0x0A0D0D0A;
  static constexpr std::uint32_t kInterface = 1, kObsolete = 2, kSimple = 3, kEnhanced = 6;
  static constexpr std::size_t kPacketHeader = 20;  // of the body of an enhanced or obsolete block

  static std::uint32_t swapped(std::uint32_t v) {
    return v >> 24 | (v >> 8 & 0xFF00) | (v << 8 & 0xFF0000) | v << 24;
  }

  [[nodiscard]] std::uint32_t u32(ByteSpan bytes, std::size_t at) const {
    const std::uint32_t big = big16(bytes, at) << 16 | big16(bytes, at + 2);
    return is_big_ ? big : swapped(big);
  }
  [[nodiscard]] std::uint32_t u16(ByteSpan bytes, std::size_t at) const {
    const std::uint32_t big = big16(bytes, at);
    return is_big_ ? big : (big >> 8 | (big << 8 & 0xFF00));
  }

  ByteSpan bytes(std::size_t size, const char* what) {
    return {reinterpret_cast<const std::byte*>(input_.bytes(size, what)), size};
  }

  void read_header(std::uint32_t magic) {
    is_big_ = magic == swapped(kMicroseconds) || magic == swapped(kNanoseconds);
    const std::uint32_t native = is_big_ ? swapped(magic) : magic;
    if (native != kMicroseconds && native != kNanoseconds) {
      throw FormatError::at_byte(0, "expected a pcap or pcapng file");
    }
    tick_ns_ = native == kNanoseconds ? 1 : 1000;
    const ByteSpan header = bytes(24, "the header");
    // The upper half of the link type can contain the length of checksums.
    constexpr std::uint32_t kLinkMask = 0xFFFF;
    link_ = u32(header, 20) & kLinkMask;
  }

  bool next_classic(Record& record) {
    if (input_.at_end()) return false;
    const std::int64_t offset = input_.offset();
    const ByteSpan header = bytes(16, "the header of a record");
    record.time_ns = kSecond * u32(header, 0) + tick_ns_ * u32(header, 4);
    const std::uint32_t stored = u32(header, 8);
    record.is_whole = stored >= u32(header, 12);
    record.link = link_;
    check_length(stored, offset + 8);
    record.bytes = bytes(stored, "a record");
    return true;
  }

  static void check_length(std::size_t length, std::int64_t offset) {
    if (length <= kLargestRecord) return;
    throw FormatError::at_byte(offset, "expected records of at most " +
                                           std::to_string(kLargestRecord) + " bytes, got " +
                                           std::to_string(length));
  }

  static bool is_read(std::uint32_t type) {
    return type == kSection || type == kInterface || type == kObsolete || type == kSimple ||
           type == kEnhanced;
  }

  // draft-ietf-opsawg-pcapng: blocks of (type, length, body, length). The first block of a section
  // determines its byte order. Blocks of other types may have any length.
  bool next_ng(Record& record) {
    while (!input_.at_end()) {
      const std::int64_t offset = input_.offset();
      const std::string_view seen = input_.peek(12);
      if (seen.size() < 12) bytes(12, "a block");  // throws, with the byte
      const ByteSpan head{reinterpret_cast<const std::byte*>(seen.data()), seen.size()};
      if (u32(head, 0) == kSection) start_section(head, offset);
      const std::uint32_t type = u32(head, 0);
      const std::uint32_t length = u32(head, 4);
      if (length < 12 || length % 4 != 0) {
        throw FormatError::at_byte(
            offset + 4,
            "expected a block of 12 bytes or more, a multiple of 4, got " + std::to_string(length));
      }
      if (!is_read(type)) {
        skip(length);
        continue;
      }
      check_length(length, offset + 4);
      const ByteSpan body = bytes(length, "a block").subspan(8, length - 12);
      if (type == kInterface) add_interface(body, offset);
      if (type == kSimple) return read_simple(body, offset, record);
      if (type == kEnhanced || type == kObsolete) return read_packet(type, body, offset, record);
    }
    return false;
  }

  // Reads over a block in pieces, so that memory stays bounded.
  void skip(std::size_t length) {
    while (length > 0) {
      const std::size_t piece = std::min(length, kLargestRecord);
      bytes(piece, "a block");
      length -= piece;
    }
  }

  void start_section(ByteSpan head, std::int64_t offset) {
    constexpr std::uint32_t kOrder = 0x1A2B3C4D;
    is_big_ = true;
    is_big_ = u32(head, 8) == kOrder;
    if (u32(head, 8) != kOrder) {
      throw FormatError::at_byte(offset + 8, "expected the byte order mark 1A2B3C4D");
    }
    interfaces_.clear();
  }

  struct Interface {
    std::uint32_t link = 0;
    std::uint64_t ticks_per_second = 1'000'000;
    std::int64_t offset_s = 0;  // added to all times
  };

  // Ticks per second by the option if_tsresol: a power of ten, or of two if its highest bit is set.
  // 0 if they exceed 64 bits.
  static std::uint64_t per_second_of(unsigned resolution) {
    constexpr unsigned kBinary = 0x80, kMaxTens = 19;
    const unsigned exponent = resolution & ~kBinary;
    if ((resolution & kBinary) != 0) return exponent < 64 ? std::uint64_t{1} << exponent : 0;
    std::uint64_t ticks = exponent <= kMaxTens ? 1 : 0;
    for (unsigned i = 0; ticks != 0 && i < exponent; ++i) ticks *= 10;
    return ticks;
  }

  // Nanoseconds since 1970; empty: the interface's clock is unknown, or they do not fit 64 bits.
  static std::optional<std::int64_t> nanoseconds(std::uint64_t ticks, const Interface& clock) {
    constexpr std::int64_t kFurthest = 9'000'000'000;  // seconds: the year 2255
    const std::uint64_t per_second = clock.ticks_per_second;
    std::int64_t seconds = 0;
    if (per_second == 0 || __builtin_add_overflow(ticks / per_second, clock.offset_s, &seconds) ||
        seconds < -kFurthest || seconds > kFurthest) {
      return std::nullopt;
    }
    const double part = static_cast<double>(ticks % per_second) / static_cast<double>(per_second);
    return kSecond * seconds + std::llround(static_cast<double>(kSecond) * part);
  }

  [[noreturn]] static void fail_short(std::int64_t offset) {
    throw FormatError::at_byte(offset, "a block is too short for what it should hold");
  }

  void add_interface(ByteSpan body, std::int64_t offset) {
    constexpr std::size_t kMaxInterfaces = 4096;
    if (body.size() < 8) fail_short(offset);
    if (interfaces_.size() == kMaxInterfaces) {
      throw FormatError::at_byte(offset, "more than 4096 interfaces");
    }
    Interface added{u16(body, 0)};
    std::size_t at = 8;
    while (at + 4 <= body.size() && u16(body, at) != 0) {
      const std::size_t size = u16(body, at + 2);
      if (size > body.size() - at - 4) fail_short(offset);
      read_option(u16(body, at), body.subspan(at + 4, size), added);
      at += 4 + (size + 3) / 4 * 4;
    }
    interfaces_.push_back(added);
  }

  void read_option(std::uint32_t code, ByteSpan value, Interface& interface) const {
    constexpr std::uint32_t kTimeResolution = 9, kTimeOffset = 14;
    if (code == kTimeResolution && !value.empty()) {
      interface.ticks_per_second = per_second_of(std::to_integer<unsigned>(value[0]));
    } else if (code == kTimeOffset && value.size() >= 8) {
      const std::uint64_t first = u32(value, 0), second = u32(value, 4);
      interface.offset_s =
          static_cast<std::int64_t>(is_big_ ? first << 32 | second : second << 32 | first);
    }
  }

  // Reads an enhanced block, or an obsolete one, whose number of the interface has 16 bits, because
  // a count of dropped packets follows it.
  bool read_packet(std::uint32_t type, ByteSpan body, std::int64_t offset, Record& record) {
    if (body.size() < kPacketHeader) fail_short(offset);
    const std::uint32_t interface = type == kObsolete ? u16(body, 0) : u32(body, 0);
    const std::size_t stored = u32(body, 12);
    if (stored > body.size() - kPacketHeader) fail_short(offset);
    if (interface >= interfaces_.size()) {
      throw FormatError::at_byte(offset + 8, "no interface " + std::to_string(interface));
    }
    const std::uint64_t ticks = std::uint64_t{u32(body, 4)} << 32 | u32(body, 8);
    record.time_ns = nanoseconds(ticks, interfaces_[interface]);
    record.link = interfaces_[interface].link;
    record.is_whole = stored >= u32(body, 16);
    record.bytes = body.subspan(kPacketHeader, stored);
    return true;
  }

  bool read_simple(ByteSpan body, std::int64_t offset, Record& record) {
    if (body.size() < 4) fail_short(offset);
    if (interfaces_.empty()) throw FormatError::at_byte(offset, "no interface 0");
    const std::size_t length = u32(body, 0);
    record.time_ns.reset();  // this block has no time
    record.link = interfaces_[0].link;
    record.is_whole = length <= body.size() - 4;
    record.bytes = body.subspan(4, std::min(length, body.size() - 4));
    return true;
  }

  InputBuffer input_;
  bool is_ng_ = false;
  bool is_big_ = false;
  std::int64_t tick_ns_ = 1000;
  std::uint32_t link_ = 0;
  std::vector<Interface> interfaces_;
};

PcapReader::PcapReader(std::unique_ptr<ByteSource> source)
    : source_(std::move(source)), records_(std::make_unique<Records>(*source_)) {}

PcapReader::~PcapReader() = default;

bool PcapReader::next(UdpPacket& packet) {
  Records::Record record;
  while (records_->next(record)) {
    ++counters_.packets;
    Datagram datagram;
    switch (datagram_of(record.bytes, record.link, datagram)) {
      case Found::kUdp:
        ++counters_.udp;
        packet = {record.time_ns, datagram.sender, datagram.payload};
        return true;
      case Found::kFragment:
        ++counters_.fragments;
        break;
      case Found::kCut:
        ++counters_.cut_short;
        break;
      case Found::kOther:
        ++(record.is_whole ? counters_.other : counters_.cut_short);
        break;
    }
  }
  return false;
}

}  // namespace manip3d
