#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "manip3d/files/descriptor.hpp"

/// @file
/// UDP packets, received by a thread of their own.
namespace manip3d {

struct UdpOptions {
  std::string address = "127.0.0.1";  ///< An address of this machine; 0.0.0.0: all of them.
  std::uint16_t port = 2368;          ///< 0: a free port, which port() returns.
  std::string sender;                 ///< Accept packets from this address only; empty: from all.
  std::size_t ring_packets = 16384;   ///< Size of the ring of waiting packets: 4 s of an HDL-64E.
};

struct UdpCounters {
  std::int64_t packets = 0;         ///< Packets put into the ring.
  std::int64_t dropped = 0;         ///< Packets that came while the ring was full.
  std::int64_t dropped_kernel = 0;  ///< Packets that came while the socket's buffer was full.
  std::int64_t other_sender = 0;
  std::int64_t too_long = 0;  ///< Packets of more than kMaxUdpBytes.
};

constexpr std::size_t kMaxUdpBytes = 1536;

/// Receives packets between `start` and `stop` (or destruction). Any thread may call any method at
/// any time; `stop` ends the wait of `read`.
class UdpReceiver {
 public:
  /// Binds the port.
  /// @throws InputError   the address or the sender is not an IPv4 address, or ring_packets is 0.
  /// @throws DeviceError  the address is not one of this machine, or the port is taken.
  explicit UdpReceiver(const UdpOptions& options = {});
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;
  ~UdpReceiver();

  /// Starts the receiving thread. It has no effect if the thread runs already.
  /// @throws std::system_error  the system cannot create a thread; the receiver is stopped then.
  void start();
  /// Ends the thread. Waiting packets can still be read.
  void stop();
  /// Removes the oldest waiting packet; waits for one while the receiver runs.
  /// @param payload  Bytes of the packet without its headers; unchanged if there is none.
  /// @param time_ns  Time at which the kernel received it, nanoseconds since 1970; 0: unknown.
  /// @param timeout  More than an hour counts as an hour.
  /// @param sender   Receives the sender's IPv4 address in network order; may be null.
  /// @return  false: no packet came within `timeout`, or the receiver is stopped and no packet
  ///          waits.
  bool read(std::vector<std::byte>& payload, std::int64_t& time_ns,
            std::chrono::milliseconds timeout, std::uint32_t* sender = nullptr);

  [[nodiscard]] std::uint16_t port() const { return port_; }
  [[nodiscard]] bool is_running() const;
  [[nodiscard]] UdpCounters counters() const;

 private:
  struct Slot {
    std::int64_t time_ns = 0;
    std::size_t size = 0;
    std::uint32_t sender = 0;  // network order
  };

  void receive();
  void end_of_thread();
  void put(const std::byte* data, const Slot& slot);

  Descriptor socket_;
  Descriptor wake_;  // an eventfd that ends the thread's wait
  std::uint16_t port_ = 0;
  std::uint32_t sender_ = 0;  // network order; 0: all
  std::vector<Slot> slots_;
  std::vector<std::byte> bytes_;  // kMaxUdpBytes per slot
  mutable std::mutex mutex_;      // guards the members below, and the waiting slots
  std::condition_variable arrived_;
  std::size_t begin_ = 0, count_ = 0;
  bool running_ = false;
  UdpCounters counters_;
  std::mutex start_stop_;  // one `start` or `stop` at a time; locked before mutex_
  std::thread thread_;
};

}  // namespace manip3d
