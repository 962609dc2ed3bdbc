#include "manip3d/capture/udp.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "capture/longest_wait.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

[[noreturn]] void refuse(const std::string& what) {
  throw DeviceError(what + ": " + std::strerror(errno));
}

in_addr address_of(const std::string& text, const char* name) {
  in_addr address{};
  if (inet_pton(AF_INET, text.c_str(), &address) != 1) {
    throw InputError(std::string(name) + ": expected an IPv4 address, got '" + text + "'");
  }
  return address;
}

Descriptor bound_socket(const UdpOptions& options, std::uint16_t& port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(options.port);
  address.sin_addr = address_of(options.address, "address");
  Descriptor owner(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!owner.is_open()) refuse("UDP socket");
  const int descriptor = owner.get();
  // Ask for a receive buffer of 8 MiB, which holds a second of packets; the system may grant less.
  const int wanted = 8 << 20, yes = 1;
  if (setsockopt(descriptor, SOL_SOCKET, SO_RCVBUFFORCE, &wanted, sizeof(wanted)) != 0) {
    setsockopt(descriptor, SOL_SOCKET, SO_RCVBUF, &wanted, sizeof(wanted));
  }
  setsockopt(descriptor, SOL_SOCKET, SO_RXQ_OVFL, &yes, sizeof(yes));
  setsockopt(descriptor, SOL_SOCKET, SO_TIMESTAMPNS, &yes, sizeof(yes));
  socklen_t size = sizeof(address);
  auto* generic = reinterpret_cast<sockaddr*>(&address);
  if (bind(descriptor, generic, size) != 0 || getsockname(descriptor, generic, &size) != 0) {
    refuse("UDP port " + options.address + ":" + std::to_string(options.port));
  }
  port = ntohs(address.sin_port);
  return owner;
}

struct Arrival {
  std::int64_t time_ns = 0;
  // packets that the kernel has dropped since the socket was opened; 0: unknown
  std::int64_t dropped = 0;
};

// Reads what the kernel notes about a packet.
Arrival arrival_of(msghdr& message) {
  Arrival arrival;
  for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
    if (c->cmsg_level != SOL_SOCKET) continue;
    if (c->cmsg_type == SO_RXQ_OVFL) {
      std::uint32_t dropped = 0;
      std::memcpy(&dropped, CMSG_DATA(c), sizeof(dropped));
      arrival.dropped = dropped;
    } else if (c->cmsg_type == SCM_TIMESTAMPNS) {
      timespec time{};
      std::memcpy(&time, CMSG_DATA(c), sizeof(time));
      constexpr std::int64_t kSecond = 1'000'000'000;
      arrival.time_ns = kSecond * time.tv_sec + time.tv_nsec;
    }
  }
  return arrival;
}

}  // namespace

UdpReceiver::UdpReceiver(const UdpOptions& options) {
  if (options.ring_packets == 0) throw InputError("ring_packets: expected > 0, got 0");
  if (!options.sender.empty()) sender_ = address_of(options.sender, "sender").s_addr;
  slots_.resize(options.ring_packets);
  bytes_.resize(options.ring_packets * kMaxUdpBytes);
  socket_ = bound_socket(options, port_);
  wake_ = Descriptor(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!wake_.is_open()) refuse("eventfd");
}

UdpReceiver::~UdpReceiver() { stop(); }

void UdpReceiver::start() {
  const std::lock_guard turn(start_stop_);
  {
    const std::lock_guard lock(mutex_);
    if (running_) return;
  }
  if (thread_.joinable()) thread_.join();  // the thread has ended by itself
  const std::lock_guard lock(mutex_);
  thread_ = std::thread(&UdpReceiver::receive, this);
  // set last, because a running receiver without a thread could not be started again
  running_ = true;
}

void UdpReceiver::stop() {
  const std::lock_guard turn(start_stop_);
  end_of_thread();
  if (!thread_.joinable()) return;
  // The counter of this eventfd cannot overflow, so that the write does not fail.
  eventfd_write(wake_.get(), 1);
  thread_.join();
  eventfd_t taken = 0;
  eventfd_read(wake_.get(), &taken);
}

void UdpReceiver::end_of_thread() {
  const std::lock_guard lock(mutex_);
  running_ = false;
  arrived_.notify_all();
}

void UdpReceiver::receive() {
  std::array<std::byte, kMaxUdpBytes> data;
  alignas(cmsghdr) std::array<char, 256> control;
  std::array<pollfd, 2> waits{pollfd{socket_.get(), POLLIN, 0}, pollfd{wake_.get(), POLLIN, 0}};
  while (true) {
    if (poll(waits.data(), waits.size(), -1) < 0 && errno != EINTR) break;
    if ((waits[1].revents & POLLIN) != 0) break;
    sockaddr_in from{};
    iovec piece{data.data(), data.size()};
    msghdr message{};
    message.msg_name = &from;
    message.msg_namelen = sizeof(from);
    message.msg_iov = &piece;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t size = recvmsg(socket_.get(), &message, MSG_DONTWAIT);
    if (size < 0) continue;  // no packet, or an ICMP error, which can be ignored
    const Arrival arrival = arrival_of(message);
    {
      const std::lock_guard lock(mutex_);
      counters_.dropped_kernel = std::max(counters_.dropped_kernel, arrival.dropped);
      if (sender_ != 0 && from.sin_addr.s_addr != sender_) {
        ++counters_.other_sender;
      } else if ((message.msg_flags & MSG_TRUNC) != 0) {
        ++counters_.too_long;
      } else {
        put(data.data(), {arrival.time_ns, static_cast<std::size_t>(size), from.sin_addr.s_addr});
      }
    }
    arrived_.notify_one();
  }
  end_of_thread();
}

void UdpReceiver::put(const std::byte* data, const Slot& slot) {
  if (count_ == slots_.size()) {
    ++counters_.dropped;
    return;
  }
  const std::size_t index = (begin_ + count_) % slots_.size();
  slots_[index] = slot;
  std::memcpy(bytes_.data() + index * kMaxUdpBytes, data, slot.size);
  ++count_;
  ++counters_.packets;
}

bool UdpReceiver::read(std::vector<std::byte>& payload, std::int64_t& time_ns,
                       std::chrono::milliseconds timeout, std::uint32_t* sender) {
  std::unique_lock lock(mutex_);
  arrived_.wait_for(lock, std::min(timeout, kLongestWait),
                    [this] { return count_ > 0 || !running_; });
  if (count_ == 0) return false;
  const Slot& slot = slots_[begin_];
  const std::byte* data = bytes_.data() + begin_ * kMaxUdpBytes;
  payload.assign(data, data + slot.size);
  time_ns = slot.time_ns;
  if (sender != nullptr) *sender = slot.sender;
  begin_ = (begin_ + 1) % slots_.size();
  --count_;
  return true;
}

bool UdpReceiver::is_running() const {
  const std::lock_guard lock(mutex_);
  return running_;
}

UdpCounters UdpReceiver::counters() const {
  const std::lock_guard lock(mutex_);
  return counters_;
}

}  // namespace manip3d
