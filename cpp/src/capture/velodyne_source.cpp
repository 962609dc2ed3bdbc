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

constexpr std::size_t kMaxSenders = 256;

}  // namespace

VelodynePcapSource::VelodynePcapSource(const fs::path& path, VelodyneOptions options,
                                       std::optional<std::uint16_t> port, std::uint64_t max_bytes,
                                       std::string sensor)
    : path_(path),
      reader_(opened(path, max_bytes)),
      decoder_(std::move(options)),
      port_(port),
      sensor_(std::move(sensor)) {}

ReadStatus VelodynePcapSource::read(VelodyneFrame& frame, std::chrono::milliseconds) {
  while (!decoder_.take(frame)) {
    if (error_) std::rethrow_exception(error_);
    if (at_end_) return ReadStatus::kEnd;
    read_packet();
  }
  return ReadStatus::kFrame;
}

void VelodynePcapSource::read_packet() {
  try {
    UdpPacket packet;
    if (reader_.next(packet)) {
      if (is_wanted(packet)) decoder_.decode(packet.payload, packet.time_ns);
      return;
    }
    if (!sensor_.empty() && !chosen_ && !senders_.empty()) refuse_sensor();
  } catch (const FormatError& error) {
    error_ = std::make_exception_ptr(error.in_file(path_.string()));
  }
  at_end_ = true;
  decoder_.flush();
}

// Packets that are no data packets are wanted, too: the decoder counts them.
bool VelodynePcapSource::is_wanted(const UdpPacket& packet) {
  if (port_ && packet.sender.destination_port != *port_) return false;
  if (!is_velodyne_data(packet.payload)) return true;
  if (chosen_ && packet.sender == *chosen_) return true;
  if (std::find(senders_.begin(), senders_.end(), packet.sender) == senders_.end() &&
      add_sender(packet.sender)) {
    if (chosen_) refuse_sensor();
    chosen_ = packet.sender;
    return true;
  }
  ++other_sender_;
  return false;
}

// Adds a sender to the list; returns whether it is one that the caller chose.
bool VelodynePcapSource::add_sender(const UdpSender& sender) {
  if (senders_.size() == kMaxSenders) return false;
  senders_.push_back(sender);
  if (sensor_.empty()) return true;
  return sensor_ == std::to_string(senders_.size() - 1) || sensor_ == sender.address_text() ||
         sensor_ == sender.text();
}

// Reads on, so that the error lists all sensors, not only the first two.
void VelodynePcapSource::refuse_sensor() {
  constexpr int kMaxPackets = 100'000;
  try {
    UdpPacket packet;
    for (int i = 0; i < kMaxPackets && reader_.next(packet); ++i) {
      const bool is_new =
          std::find(senders_.begin(), senders_.end(), packet.sender) == senders_.end();
      const bool is_other_port = port_ && packet.sender.destination_port != *port_;
      if (is_new && !is_other_port && is_velodyne_data(packet.payload)) add_sender(packet.sender);
    }
  } catch (const FormatError&) {  // the sensors before the damage are listed
  }
  constexpr std::size_t kMaxTold = 8;
  std::string told;
  for (std::size_t i = 0; i < std::min(senders_.size(), kMaxTold); ++i) {
    told += (i == 0 ? "#" : ", #") + std::to_string(i) + " (" + senders_[i].text() + ")";
  }
  if (senders_.size() > kMaxTold) told += ", ...";
  const std::string given = sensor_.empty() ? "none" : "#" + sensor_;
  error_ = std::make_exception_ptr(InputError(
      "uri: expected pcap:" + path_.string() +
      "#N or #ADDRESS, one of the sensors of the recording: " + told + "; got " + given));
  std::rethrow_exception(error_);
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
    std::uint32_t sender = 0;
    if (receiver_.read(payload_, time_ns, std::max(left, std::chrono::milliseconds(0)), &sender)) {
      const bool is_data = is_velodyne_data(payload_);
      if (is_data && !sender_) sender_ = sender;
      if (is_data && sender != *sender_) {
        ++other_sender_;
      } else {
        decoder_.decode(payload_, time_ns == 0 ? std::nullopt : std::optional(time_ns));
      }
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
