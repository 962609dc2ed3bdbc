#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>

#include "manip3d/capture/frame_source.hpp"
#include "manip3d/capture/pcap.hpp"
#include "manip3d/capture/udp.hpp"
#include "manip3d/capture/velodyne.hpp"

/// @file
/// Velodyne frames from recordings and live sensors.
namespace manip3d {

/// Frames of a pcap or pcapng file (also `.gz` or `.xz`). The last frame may be incomplete.
class VelodynePcapSource final : public FrameSource<VelodyneFrame> {
 public:
  /// @param port       Accept packets to this port only; empty: all packets of Velodyne's formats.
  /// @param max_bytes  Limit of uncompressed bytes; 0: that of decompressed().
  /// @throws FormatError  the path is a pipe, socket or device, or the file does not begin like a
  ///                      recording or like the compression that its name says.
  /// @throws InputError   an option is out of range, the number of lasers is not the model's, or
  ///                      the path has a NUL character.
  /// @throws std::filesystem::filesystem_error  the operating system refused to open the file.
  VelodynePcapSource(const std::filesystem::path& path, VelodyneOptions options = {},
                     std::optional<std::uint16_t> port = {}, std::uint64_t max_bytes = 0);

  [[nodiscard]] SourceCapabilities capabilities() const override { return {}; }
  void start() override {}
  /// @throws FormatError  the file ends within a record, a record is too long, or compressed data
  ///                      are damaged or too large.
  /// @throws InputError   the packets are those of an HDL-64E, and there is no calibration.
  /// @throws std::filesystem::filesystem_error  the operating system refused to read the file.
  ReadStatus read(VelodyneFrame& frame, std::chrono::milliseconds timeout) override;
  void stop() override {}

  [[nodiscard]] const VelodyneCounters& counters() const { return decoder_.counters(); }
  [[nodiscard]] const PcapCounters& file_counters() const { return reader_.counters(); }

 private:
  std::filesystem::path path_;
  PcapReader reader_;
  VelodyneDecoder decoder_;
  std::optional<std::uint16_t> port_;
  bool at_end_ = false;
};

/// Frames of a sensor that sends to this machine. No packet is lost if `read` is called often
/// enough for the size of the ring (UdpOptions); losses are counted.
class VelodyneUdpSource final : public FrameSource<VelodyneFrame> {
 public:
  /// @throws InputError   an option is out of range, the number of lasers is not the model's, or an
  ///                      address is not one of IPv4.
  /// @throws DeviceError  the operating system refused to open the port.
  explicit VelodyneUdpSource(const UdpOptions& udp, VelodyneOptions options = {});

  [[nodiscard]] SourceCapabilities capabilities() const override { return {true}; }
  void start() override { receiver_.start(); }
  /// After `stop`, returns the frames that are still in the ring, then the incomplete frame, then
  /// kEnd.
  /// @throws InputError  the packets are those of an HDL-64E, and there is no calibration.
  ReadStatus read(VelodyneFrame& frame, std::chrono::milliseconds timeout) override;
  void stop() override { receiver_.stop(); }

  [[nodiscard]] std::uint16_t port() const { return receiver_.port(); }
  [[nodiscard]] const VelodyneCounters& counters() const { return decoder_.counters(); }
  [[nodiscard]] UdpCounters udp_counters() const { return receiver_.counters(); }

 private:
  UdpReceiver receiver_;
  VelodyneDecoder decoder_;
  std::vector<std::byte> payload_;
};

}  // namespace manip3d
