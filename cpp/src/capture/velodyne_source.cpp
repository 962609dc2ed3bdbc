#include "manip3d/capture/velodyne_source.hpp"

#include <algorithm>
#include <utility>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

PcapReader opened(const fs::path& path, std::uint64_t max_bytes) {
  try {
    return PcapReader(decompressed(file_source(path), compression_of(path), max_bytes));
  } catch (const FormatError& error) {
    throw error.in_file(path.string());
  }
}

}  // namespace

VelodynePcapSource::VelodynePcapSource(const fs::path& path, VelodyneOptions options,
                                       std::optional<std::uint16_t> port, std::uint64_t max_bytes)
    : path_(path), reader_(opened(path, max_bytes)), decoder_(std::move(options)), port_(port) {}

ReadStatus VelodynePcapSource::read(VelodyneFrame& frame, std::chrono::milliseconds) {
  try {
    UdpPacket packet;
    while (!decoder_.take(frame)) {
      if (at_end_) return ReadStatus::kEnd;
      if (!reader_.next(packet)) {
        at_end_ = true;
        decoder_.flush();
      } else if (!port_ || packet.destination_port == *port_) {
        decoder_.decode(packet.payload, packet.time_ns);
      }
    }
    return ReadStatus::kFrame;
  } catch (const FormatError& error) {
    throw error.in_file(path_.string());
  }
}

VelodyneUdpSource::VelodyneUdpSource(const UdpOptions& udp, VelodyneOptions options)
    : receiver_(udp), decoder_(std::move(options)) {}

ReadStatus VelodyneUdpSource::read(VelodyneFrame& frame, std::chrono::milliseconds timeout) {
  using Steady = std::chrono::steady_clock;
  const auto deadline = Steady::now() + timeout;
  std::int64_t time_ns = 0;
  while (!decoder_.take(frame)) {
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Steady::now());
    // asked before the read, so that packets from before the end are not missed
    const bool was_running = receiver_.is_running();
    if (receiver_.read(payload_, time_ns, std::max(left, std::chrono::milliseconds(0)))) {
      decoder_.decode(payload_, time_ns);
    } else if (was_running) {
      return ReadStatus::kTimeout;
    } else {
      decoder_.flush();
      return decoder_.take(frame) ? ReadStatus::kFrame : ReadStatus::kEnd;
    }
  }
  return ReadStatus::kFrame;
}

}  // namespace manip3d
