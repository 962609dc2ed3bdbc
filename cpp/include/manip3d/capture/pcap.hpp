#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "manip3d/io/byte_source.hpp"

/// @file
/// UDP payloads out of recordings of network traffic. Not by libpcap: it would put eight shared
/// libraries, D-Bus and systemd among them, into every wheel, reads no compressed recordings and
/// does not say at which byte a damaged one is damaged.
namespace manip3d {

/// One UDP payload, valid until the next call of PcapReader::next.
struct UdpPacket {
  std::int64_t time_ns = 0;  ///< Since 1970.
  std::uint16_t destination_port = 0;
  std::span<const std::byte> payload;
};

struct PcapCounters {
  std::int64_t packets = 0;    ///< Records of the file.
  std::int64_t udp = 0;        ///< Payloads given.
  std::int64_t other = 0;      ///< No IP, no UDP, a link type that is not known here.
  std::int64_t fragments = 0;  ///< Pieces of IP datagrams; they are not put together.
  std::int64_t cut_short = 0;  ///< Recorded only in part, or shorter than their headers say.
};

/// Reads pcap (either byte order, micro- or nanoseconds) and pcapng, from front to back.
///
/// Link types: Ethernet with 802.1Q tags, BSD loopback, raw IP, Linux cooked v1 and v2. IPv4 and
/// IPv6. Memory is bounded by the largest record, 256 KiB at most.
class PcapReader {
 public:
  /// @throws FormatError  the file does not start like one.
  explicit PcapReader(std::unique_ptr<ByteSource> source);
  PcapReader(const PcapReader&) = delete;
  PcapReader& operator=(const PcapReader&) = delete;
  ~PcapReader();

  /// The next UDP payload; false at the end.
  /// @throws FormatError  with the byte: the file ends within a record, or a record is too long.
  bool next(UdpPacket& packet);
  [[nodiscard]] const PcapCounters& counters() const { return counters_; }

 private:
  class Records;
  std::unique_ptr<ByteSource> source_;
  std::unique_ptr<Records> records_;
  PcapCounters counters_;
};

}  // namespace manip3d
