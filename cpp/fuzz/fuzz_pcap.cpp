#include <cstdlib>
#include <numeric>

#include "manip3d/capture/pcap.hpp"
#include "manip3d/error.hpp"

// Reads the bytes as a recording: payloads that are readable to the end, or a FormatError with a
// reason. Each record is counted once.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    manip3d::PcapReader reader(manip3d::memory_source(std::as_bytes(std::span(data, size))));
    manip3d::UdpPacket packet;
    std::size_t sum = 0;
    while (reader.next(packet)) {
      if (packet.sender.text().find(packet.sender.address_text()) > 1) std::abort();
      for (const std::byte b : packet.payload) sum += std::to_integer<std::size_t>(b);
    }
    const manip3d::PcapCounters& c = reader.counters();
    const bool all = c.packets == c.udp + c.other + c.fragments + c.cut_short;
    if (!all || sum > 255 * size) std::abort();
  } catch (const manip3d::FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
  return 0;
}
