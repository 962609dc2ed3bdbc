#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <system_error>
#include <thread>
#include <vector>

#include "manip3d/capture/udp.hpp"
#include "manip3d/capture/velodyne_source.hpp"
#include "manip3d/error.hpp"
#include "no_threads.hpp"

// Also run under the thread sanitizer: one thread receives, one sends, one reads.
namespace manip3d {
namespace {

using std::chrono::milliseconds;

void send_numbers(std::uint16_t port, int count, milliseconds pause) {
  const int descriptor = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  for (int i = 0; i < count; ++i) {
    sendto(descriptor, &i, sizeof(i), 0, reinterpret_cast<sockaddr*>(&address), sizeof(address));
    if (i % 16 == 15) std::this_thread::sleep_for(pause);
  }
  close(descriptor);
}

/// Checks that a stopped receiver can be started again.
void expect_to_receive(UdpReceiver& receiver) {
  receiver.start();
  send_numbers(receiver.port(), 1, milliseconds(0));
  std::vector<std::byte> payload;
  std::int64_t time_ns = 0;
  EXPECT_TRUE(receiver.read(payload, time_ns, milliseconds(20'000)));
}

UdpOptions any_port(std::size_t ring_packets = 16384) {
  UdpOptions options;
  options.port = 0;
  options.ring_packets = ring_packets;
  return options;
}

TEST(UdpReceiver, PacketsComeInOrder) {
  constexpr int kCount = 2000;
  UdpReceiver receiver(any_port(64));
  receiver.start();
  std::thread sender(send_numbers, receiver.port(), kCount, milliseconds(2));
  std::vector<std::byte> payload;
  std::int64_t time_ns = 0;
  std::int64_t received = 0;
  int last = -1;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (last + 1 < kCount && std::chrono::steady_clock::now() < deadline) {
    if (!receiver.read(payload, time_ns, milliseconds(20))) continue;
    int number = 0;
    ASSERT_EQ(payload.size(), sizeof(number));
    std::memcpy(&number, payload.data(), sizeof(number));
    ASSERT_GT(number, last);
    last = number;
    ++received;
  }
  sender.join();
  receiver.stop();
  const UdpCounters counters = receiver.counters();
  EXPECT_EQ(counters.packets, received);
  EXPECT_EQ(received + counters.dropped + counters.dropped_kernel, kCount);
}

TEST(UdpReceiver, StartsAndStopsManyTimes) {
  UdpReceiver receiver(any_port(4));
  std::vector<std::byte> payload;
  std::int64_t time_ns = 0;
  for (int i = 0; i < 20; ++i) {
    receiver.start();
    EXPECT_TRUE(receiver.is_running());
    receiver.stop();
    receiver.stop();
    EXPECT_FALSE(receiver.is_running());
    EXPECT_FALSE(receiver.read(payload, time_ns, milliseconds(0)));
  }
}

TEST(UdpReceiver, StopEndsAWaitingRead) {
  UdpReceiver receiver(any_port(4));
  receiver.start();
  std::thread stopper([&] {
    std::this_thread::sleep_for(milliseconds(20));
    receiver.stop();
  });
  std::vector<std::byte> payload;
  std::int64_t time_ns = 0;
  EXPECT_FALSE(receiver.read(payload, time_ns, std::chrono::minutes(10)));
  stopper.join();
}

TEST(VelodyneUdpSource, CountersMayBeReadMeanwhile) {
  VelodyneUdpSource source(any_port(64));
  source.start();
  EXPECT_TRUE(source.capabilities().is_live);
  std::thread sender(send_numbers, source.port(), 200, milliseconds(1));
  VelodyneFrame frame;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (source.udp_counters().packets < 200 && std::chrono::steady_clock::now() < deadline) {
    EXPECT_EQ(source.read(frame, milliseconds(5)), ReadStatus::kTimeout);
  }
  sender.join();
  source.stop();
  EXPECT_EQ(source.read(frame, milliseconds(0)), ReadStatus::kEnd);
  EXPECT_EQ(source.counters().bad_length, source.udp_counters().packets);
}

TEST(UdpReceiver, StopsFromAnyThreadAtOnceAndTwice) {
  constexpr milliseconds kLong(20'000);
  UdpReceiver receiver(any_port());
  for (int trial = 0; trial < 20; ++trial) {
    receiver.start();
    const auto begin = std::chrono::steady_clock::now();
    const auto wait = [&] {
      std::vector<std::byte> payload;
      std::int64_t time_ns = 0;
      EXPECT_FALSE(receiver.read(payload, time_ns, kLong));
    };
    const auto stop_twice = [&] {
      receiver.stop();
      receiver.stop();
    };
    std::vector<std::thread> threads;
    for (int i = 0; i < 2; ++i) threads.emplace_back(wait);
    for (int i = 0; i < 3; ++i) threads.emplace_back(stop_twice);
    for (auto& thread : threads) thread.join();
    EXPECT_LT(std::chrono::steady_clock::now() - begin, kLong / 2);
    EXPECT_FALSE(receiver.is_running());
  }
}

TEST(UdpReceiver, StartsAndStopsFromManyThreadsEndInOneState) {
  UdpReceiver receiver(any_port());
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&receiver, i] {
      for (int k = 0; k < 50; ++k) {
        if ((i + k) % 2 == 0) receiver.start();
        static_cast<void>(receiver.counters());
        if ((i + k) % 2 == 1) receiver.stop();
      }
    });
  }
  for (auto& thread : threads) thread.join();
  receiver.stop();
  EXPECT_FALSE(receiver.is_running());
  expect_to_receive(receiver);
}

TEST(UdpReceiver, AStartWithoutAThreadLeavesItStopped) {
  UdpReceiver receiver(any_port());
  {
    const NoThreads none;
    EXPECT_THROW(receiver.start(), std::system_error);
  }
  EXPECT_FALSE(receiver.is_running());
  expect_to_receive(receiver);
}

TEST(UdpReceiver, TheLongestTimeoutIsNoneThatIsOver) {
  UdpReceiver receiver(any_port());
  receiver.start();
  std::thread sender([&receiver] {
    std::this_thread::sleep_for(milliseconds(200));
    send_numbers(receiver.port(), 1, milliseconds(0));
  });
  std::vector<std::byte> payload;
  std::int64_t time_ns = 0;
  EXPECT_TRUE(receiver.read(payload, time_ns, milliseconds::max()));
  EXPECT_GT(time_ns, 0);
  sender.join();
}

TEST(UdpReceiver, ABadAddressLeavesNoSocketOpen) {
  const auto next_descriptor = [] {
    const int descriptor = dup(0);
    close(descriptor);
    return descriptor;
  };
  const int before = next_descriptor();
  UdpOptions options = any_port();
  options.address = "nowhere";
  EXPECT_THROW(UdpReceiver{options}, InputError);
  EXPECT_EQ(next_descriptor(), before);
}

}  // namespace
}  // namespace manip3d
