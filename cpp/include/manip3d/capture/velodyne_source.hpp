#pragma once

#include <chrono>
#include <cstdint>
#include <exception>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

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
  /// @param sensor     Which sensor to read if several sent data: their number in order of
  ///                   appearance, from 0, or UdpSender::address_text() or UdpSender::text().
  /// @param max_bytes  Limit of uncompressed bytes; 0: that of decompressed().
  /// @throws FormatError  the path is a pipe, socket or device, or the file does not begin like a
  ///                      recording or like the compression that its name says.
  /// @throws InputError   an option is out of range, the number of lasers is not the model's, or
  ///                      the path has a NUL character.
  /// @throws std::filesystem::filesystem_error  the operating system refused to open the file.
  VelodynePcapSource(const std::filesystem::path& path, VelodyneOptions options = {},
                     std::optional<std::uint16_t> port = {}, std::uint64_t max_bytes = 0,
                     std::string sensor = "");

  [[nodiscard]] SourceCapabilities capabilities() const override { return {}; }
  void start() override {}
  /// Before a FormatError is thrown, the frame in progress is returned.
  /// @throws FormatError  the file ends within a record, a record is too long, compressed data are
  ///                      damaged or too large, or the first data packet is a VLS-128's.
  /// @throws InputError   the packets are those of an HDL-64E, and there is no calibration; several
  ///                      sensors sent data and none was chosen; the chosen one sent none.
  /// @throws std::filesystem::filesystem_error  the operating system refused to read the file.
  ReadStatus read(VelodyneFrame& frame, std::chrono::milliseconds timeout) override;
  void stop() override {}

  [[nodiscard]] const VelodyneCounters& counters() const { return decoder_.counters(); }
  [[nodiscard]] const PcapCounters& file_counters() const { return reader_.counters(); }
  /// Data packets of other sensors than the chosen one, which are ignored.
  [[nodiscard]] std::int64_t other_sender() const { return other_sender_; }

 private:
  void read_packet();
  bool is_wanted(const UdpPacket& packet);
  bool add_sender(const UdpSender& sender);
  [[noreturn]] void refuse_sensor();

  std::filesystem::path path_;
  PcapReader reader_;
  VelodyneDecoder decoder_;
  std::optional<std::uint16_t> port_;
  std::string sensor_;
  std::vector<UdpSender> senders_;  // of data packets, in order of appearance
  std::optional<UdpSender> chosen_;
  std::int64_t other_sender_ = 0;
  std::exception_ptr error_;  // thrown after the last frame
  bool at_end_ = false;
};

/// Frames of a sensor that sends to this machine. No packet is lost if `read` is called often
/// enough for the size of the ring (UdpOptions); losses are counted. If several sensors send, the
/// first one is read, and data packets of the others are counted.
class VelodyneUdpSource final : public FrameSource<VelodyneFrame> {
 public:
  /// @throws InputError   an option is out of range, the number of lasers is not the model's, or an
  ///                      address is not one of IPv4.
  /// @throws DeviceError  the address is not one of this machine, or the port is taken.
  explicit VelodyneUdpSource(const UdpOptions& udp, VelodyneOptions options = {});

  [[nodiscard]] SourceCapabilities capabilities() const override { return {true}; }
  void start() override { receiver_.start(); }
  /// After `stop`, returns the frames that are still in the ring, then the incomplete frame, then
  /// kEnd.
  /// @throws InputError   the packets are those of an HDL-64E, and there is no calibration.
  /// @throws FormatError  the first data packet is a VLS-128's.
  ReadStatus read(VelodyneFrame& frame, std::chrono::milliseconds timeout) override;
  void stop() override { receiver_.stop(); }

  [[nodiscard]] std::uint16_t port() const { return receiver_.port(); }
  [[nodiscard]] const VelodyneCounters& counters() const { return decoder_.counters(); }
  [[nodiscard]] UdpCounters udp_counters() const { return receiver_.counters(); }
  /// Data packets of other senders than the first one.
  [[nodiscard]] std::int64_t other_sender() const { return other_sender_; }

 private:
  UdpReceiver receiver_;
  VelodyneDecoder decoder_;
  std::vector<std::byte> payload_;
  std::optional<std::uint32_t> sender_;  // of data packets, network order
  std::int64_t other_sender_ = 0;
};

}  // namespace manip3d
