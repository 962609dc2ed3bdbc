#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "manip3d/files/byte_source.hpp"

/// @file
/// UDP payloads from recordings of network traffic. libpcap is not used: it would add eight shared
/// libraries to each wheel, D-Bus and systemd among them; it reads no compressed recordings and
/// does not report the byte at which a file is damaged.
namespace manip3d {

/// Sender of a UDP packet, and the port to which it sends.
struct UdpSender {
  std::array<std::byte, 16> address{};  ///< IPv4: the first 4 bytes.
  bool is_ipv6 = false;
  std::uint16_t destination_port = 0;

  bool operator==(const UdpSender&) const = default;
  /// Returns "192.168.1.201" or "fe80::1".
  [[nodiscard]] std::string address_text() const;
  /// Returns "192.168.1.201:2368" or "[fe80::1]:2368".
  [[nodiscard]] std::string text() const;
};

/// One UDP payload, valid until the next call of PcapReader::next.
struct UdpPacket {
  std::optional<std::int64_t> time_ns;  ///< Since 1970; empty: the recording does not state it.
  UdpSender sender;
  std::span<const std::byte> payload;
};

struct PcapCounters {
  /// Recorded packets: records of a pcap; Simple, Enhanced and Obsolete Packet Blocks of a pcapng.
  std::int64_t packets = 0;
  std::int64_t udp = 0;    ///< Payloads returned.
  std::int64_t other = 0;  ///< Records that are not IP or not UDP, or have an unknown link type.
  std::int64_t fragments = 0;  ///< Fragments of IP datagrams, which are not reassembled.
  /// Packets that were recorded in part only, or are shorter than their headers say.
  std::int64_t cut_short = 0;
};

/// Reads pcap (either byte order, micro- or nanoseconds) and pcapng, from front to back.
///
/// Link types: Ethernet with 802.1Q tags, BSD loopback, raw IP, Linux cooked v1 and v2. IPv4 and
/// IPv6. Memory is bounded by the largest record, 256 KiB at most.
class PcapReader {
 public:
  /// @throws FormatError  the file does not begin like a pcap or pcapng file.
  explicit PcapReader(std::unique_ptr<ByteSource> source);
  PcapReader(const PcapReader&) = delete;
  PcapReader& operator=(const PcapReader&) = delete;
  ~PcapReader();

  /// Reads the next UDP payload; returns false at the end.
  /// @throws FormatError  (with the byte) the file ends within a record, or a record is too long
  ///                      (blocks of pcapng that hold no packets may have any length).
  bool next(UdpPacket& packet);
  [[nodiscard]] const PcapCounters& counters() const { return counters_; }

 private:
  class Records;
  std::unique_ptr<ByteSource> source_;
  std::unique_ptr<Records> records_;
  PcapCounters counters_;
};

}  // namespace manip3d
