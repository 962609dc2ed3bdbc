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

#include "manip3d/io/descriptor.hpp"

/// @file
/// UDP packets as they come in, collected by a thread of their own.
namespace manip3d {

struct UdpOptions {
  std::string address = "127.0.0.1";  ///< An address of this machine; 0.0.0.0: all of them.
  std::uint16_t port = 2368;          ///< 0: one that is free.
  std::string sender;                 ///< Take packets from this address only; empty: from all.
  std::size_t ring_packets = 16384;   ///< What waits to be read: 4 s of an HDL-64E.
};

struct UdpCounters {
  std::int64_t packets = 0;         ///< Taken into the ring.
  std::int64_t dropped = 0;         ///< Came while the ring was full.
  std::int64_t dropped_kernel = 0;  ///< Came while the socket's buffer was full.
  std::int64_t other_sender = 0;
  std::int64_t too_long = 0;  ///< More than kMaxUdpBytes.
};

constexpr std::size_t kMaxUdpBytes = 1536;

/// Receives packets between `start` and `stop` (or destruction). Any thread may call any method at
/// any time; `stop` ends the wait of `read`.
class UdpReceiver {
 public:
  /// Binds the port.
  /// @throws InputError  no address of this machine.
  /// @throws DeviceError  the port is taken, and the like.
  explicit UdpReceiver(const UdpOptions& options = {});
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;
  ~UdpReceiver();

  /// Starts the thread that receives; nothing happens if it runs already.
  /// @throws std::system_error  the system gives no thread; the receiver is stopped then.
  void start();
  /// Ends the thread. Packets that wait can still be read.
  void stop();
  /// Takes the oldest packet that waits; waits for one while the receiver runs.
  /// @param payload  the bytes of the packet without its headers; unchanged if there is none.
  /// @param time_ns  when the kernel received it, nanoseconds since 1970; 0: unknown.
  /// @param timeout  longer ones than an hour count as an hour.
  /// @return  false: no packet came within `timeout`, or the receiver is stopped and none waits.
  bool read(std::vector<std::byte>& payload, std::int64_t& time_ns,
            std::chrono::milliseconds timeout);

  [[nodiscard]] std::uint16_t port() const { return port_; }
  [[nodiscard]] bool is_running() const;
  [[nodiscard]] UdpCounters counters() const;

 private:
  struct Slot {
    std::int64_t time_ns = 0;
    std::size_t size = 0;
  };

  void receive();
  void end_of_thread();
  void put(const std::byte* data, std::size_t size, std::int64_t time_ns);

  Descriptor socket_;
  Descriptor wake_;  // an eventfd that ends the wait of the thread
  std::uint16_t port_ = 0;
  std::uint32_t sender_ = 0;  // network order; 0: all
  std::vector<Slot> slots_;
  std::vector<std::byte> bytes_;  // kMaxUdpBytes per slot
  mutable std::mutex mutex_;      // guards what follows, and the slots between begin_ and its end
  std::condition_variable arrived_;
  std::size_t begin_ = 0, count_ = 0;
  bool running_ = false;
  UdpCounters counters_;
  std::mutex start_stop_;  // one of them at a time; taken before mutex_
  std::thread thread_;
};

}  // namespace manip3d
