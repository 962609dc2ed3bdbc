#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/error.hpp"
#include "no_threads.hpp"

// Also run under the thread sanitizer.
namespace manip3d {
namespace {

using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;

constexpr milliseconds kLong(20'000);

/// Delivers `count` frames as fast as they are read (-1: endless). It is unplugged after `plug`
/// frames until it is opened again.
class FakeCamera final : public RgbdSource {
 public:
  explicit FakeCamera(std::int64_t count, std::int64_t plug = -1) : count_(count), plug_(plug) {}

  [[nodiscard]] SourceCapabilities capabilities() const override { return {true}; }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    if (starts == loses_calibration) throw DeviceError("fake camera: no calibration");
    return calibration_;
  }
  [[nodiscard]] Counters counters() const override {
    if (made_ == loses_counters) throw DeviceError("fake camera: no counters");
    return {{"frames", made_}};
  }
  void start() override {
    ++starts;
    plug_ = starts > 1 ? -1 : plug_;
    calibration_ = std::make_shared<RgbdCalibration>();
  }
  void stop() override { ++stops; }
  void seek(std::int64_t index) override { made_ = index; }
  ReadStatus read(RgbdFrame& frame, milliseconds timeout) override {
    if (count_ == 0) std::this_thread::sleep_for(timeout);  // a camera without frames
    if (count_ == 0) return ReadStatus::kTimeout;
    if (made_ == plug_) throw DeviceError("fake camera: unplugged");
    if (made_ == count_) return ReadStatus::kEnd;
    std::this_thread::sleep_for(std::chrono::microseconds(200));
    frame.number = made_;
    frame.time_ns = made_ * step_ns;
    frame.depth.assign(100, static_cast<std::uint16_t>(made_));
    ++made_;
    return ReadStatus::kFrame;
  }

  int starts = 0, stops = 0;
  int loses_calibration = -1;        ///< Number of starts after which there is none.
  std::int64_t loses_counters = -1;  ///< Number of frames after which there are none.
  std::int64_t step_ns = 1'000'000;

 private:
  std::int64_t count_, plug_, made_ = 0;
  std::shared_ptr<const RgbdCalibration> calibration_;
};

std::int64_t count_of(const RgbdSource& source, const std::string& name) {
  for (const auto& [key, value] : source.counters()) {
    if (key == name) return value;
  }
  return -1;
}

bool is_whole(const RgbdFrame& frame) {
  for (const std::uint16_t value : frame.depth) {
    if (value != static_cast<std::uint16_t>(frame.number)) return false;
  }
  return frame.depth.size() == 100;
}

TEST(GrabThread, FramesComeWholeAndInOrderAndTheLostAreCounted) {
  constexpr std::int64_t kCount = 2000;
  GrabThread source(std::make_unique<FakeCamera>(kCount));
  source.start();
  RgbdFrame frame;
  std::int64_t last = -1, got = 0;
  while (source.read(frame, kLong) == ReadStatus::kFrame) {
    ASSERT_TRUE(is_whole(frame));
    ASSERT_GT(frame.number, last);
    last = frame.number;
    ++got;
    if (got % 10 == 0) std::this_thread::sleep_for(milliseconds(2));  // a slow reader
  }
  EXPECT_EQ(last, kCount - 1);  // the latest frame is kept, so that the last one is never lost
  EXPECT_GT(count_of(source, "dropped"), 0);
  EXPECT_EQ(got + count_of(source, "dropped"), kCount);
  EXPECT_EQ(count_of(source, "frames"), kCount);
}

TEST(GrabThread, AFrameThatWasReadDoesNotChange) {
  GrabThread source(std::make_unique<FakeCamera>(-1));
  source.start();
  RgbdFrame kept, other;
  ASSERT_EQ(source.read(kept, kLong), ReadStatus::kFrame);
  const std::int64_t number = kept.number;
  for (int i = 0; i < 50; ++i) ASSERT_EQ(source.read(other, kLong), ReadStatus::kFrame);
  EXPECT_EQ(kept.number, number);
  EXPECT_TRUE(is_whole(kept));
}

TEST(GrabThread, AFrameSaysWhenItWasGrabbedHoweverLongItWaits) {
  const auto now_ns = [] {
    return std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count();
  };
  const std::int64_t before = now_ns();
  GrabThread source(std::make_unique<FakeCamera>(1));
  source.start();
  std::this_thread::sleep_for(milliseconds(300));  // the frame waits
  RgbdFrame frame;
  ASSERT_EQ(source.read(frame, kLong), ReadStatus::kFrame);
  EXPECT_GE(frame.grabbed_ns, before);
  EXPECT_LE(frame.grabbed_ns, now_ns() - 100'000'000);
}

TEST(GrabThread, StopWakesAReader) {
  GrabThread source(std::make_unique<FakeCamera>(0));
  source.start();
  std::atomic<bool> is_reading = false;
  ReadStatus status = ReadStatus::kFrame;
  Clock::duration took{};
  std::thread reader([&] {
    RgbdFrame frame;
    is_reading = true;
    const auto begin = Clock::now();
    status = source.read(frame, kLong);
    took = Clock::now() - begin;
  });
  while (!is_reading) std::this_thread::yield();
  source.stop();
  reader.join();
  EXPECT_EQ(status, ReadStatus::kEnd);
  EXPECT_LT(took, kLong / 2);
}

TEST(GrabThread, NothingInTimeIsATimeout) {
  GrabThread source(std::make_unique<FakeCamera>(0));
  RgbdFrame frame;
  EXPECT_EQ(source.read(frame, milliseconds(1)), ReadStatus::kEnd);  // not started
  source.start();
  EXPECT_EQ(source.read(frame, milliseconds(1)), ReadStatus::kTimeout);
}

TEST(GrabThread, UnpluggedIsADeviceErrorAndItCanBeOpenedAgain) {
  auto camera = std::make_unique<FakeCamera>(20, 5);
  const FakeCamera& seen = *camera;
  GrabThread source(std::move(camera));
  source.start();
  RgbdFrame frame;
  std::int64_t last = -1;
  EXPECT_THROW(while (source.read(frame, kLong) == ReadStatus::kFrame) last = frame.number,
               DeviceError);
  EXPECT_EQ(last, 4);  // earlier frames are not lost with the error
  EXPECT_THROW(source.read(frame, kLong), DeviceError);
  source.start();
  while (source.read(frame, kLong) == ReadStatus::kFrame) last = frame.number;
  EXPECT_EQ(last, 19);
  source.stop();
  EXPECT_EQ(seen.starts, 2);
  EXPECT_EQ(seen.stops, 1);
  EXPECT_EQ(source.read(frame, kLong), ReadStatus::kEnd);
}

TEST(GrabThread, AStartWithoutAThreadLeavesTheCameraStopped) {
  auto made = std::make_unique<FakeCamera>(3);
  const FakeCamera& camera = *made;
  GrabThread source(std::move(made));
  {
    const NoThreads none;
    EXPECT_THROW(source.start(), std::system_error);
  }
  EXPECT_EQ(camera.starts, 1);
  EXPECT_EQ(camera.stops, 1);
  source.start();
  RgbdFrame frame;
  EXPECT_EQ(source.read(frame, kLong), ReadStatus::kFrame);
  EXPECT_EQ(camera.starts, 2);
}

TEST(GrabThread, AStartWithoutACalibrationLeavesTheCameraStopped) {
  auto made = std::make_unique<FakeCamera>(3);
  made->loses_calibration = 1;
  const FakeCamera& camera = *made;
  GrabThread source(std::move(made));
  EXPECT_THROW(source.start(), DeviceError);
  EXPECT_EQ(camera.stops, 1);
  source.start();
  RgbdFrame frame;
  EXPECT_EQ(source.read(frame, kLong), ReadStatus::kFrame);
  EXPECT_EQ(camera.starts, 2);
}

TEST(GrabThread, CountersThatAreLostAreAnErrorOfTheReader) {
  auto camera = std::make_unique<FakeCamera>(-1);
  camera->loses_counters = 3;
  GrabThread source(std::move(camera));
  source.start();
  RgbdFrame frame;
  std::int64_t last = -1;
  EXPECT_THROW(while (source.read(frame, kLong) == ReadStatus::kFrame) last = frame.number,
               DeviceError);
  EXPECT_EQ(last, 2);
  EXPECT_EQ(count_of(source, "frames"), 2);  // as of the last frame with counters
}

TEST(GrabThread, TheLongestTimeoutIsNoneThatIsOver) {
  GrabThread source(std::make_unique<FakeCamera>(1));
  source.start();
  RgbdFrame frame;
  EXPECT_EQ(source.read(frame, milliseconds::max()), ReadStatus::kFrame);
}

TEST(GrabThread, SeekLeavesNoFrameOfBefore) {
  GrabThread source(std::make_unique<FakeCamera>(-1));
  source.start();
  while (count_of(source, "frames") < 3) std::this_thread::sleep_for(milliseconds(1));
  source.stop();  // while an unread frame waits
  source.seek(100'000);
  source.start();
  RgbdFrame frame;
  ASSERT_EQ(source.read(frame, kLong), ReadStatus::kFrame);
  EXPECT_GE(frame.number, 100'000);
}

TEST(InRealTime, FramesComeAtTheirTimes) {
  auto camera = std::make_unique<FakeCamera>(11);
  camera->step_ns = 20'000'000;
  const auto source = in_real_time(std::move(camera), 2.0);
  const auto begin = Clock::now();
  source->start();
  RgbdFrame frame;
  while (source->read(frame, kLong) == ReadStatus::kFrame) {
    // Frames must not come before their time; the delay depends on the machine.
    EXPECT_GE(Clock::now() - begin, std::chrono::nanoseconds(frame.time_ns / 2));
  }
  EXPECT_EQ(frame.number, 10);
  EXPECT_THROW(in_real_time(std::make_unique<FakeCamera>(1), 0.0), InputError);
}

TEST(InRealTime, FramesAfterAStopComeAtTheirTimesToo) {
  auto camera = std::make_unique<FakeCamera>(8);
  constexpr std::int64_t kStep = 20'000'000;
  camera->step_ns = kStep;
  const auto source = in_real_time(std::move(camera), 1.0);
  source->start();
  RgbdFrame frame;
  ASSERT_EQ(source->read(frame, kLong), ReadStatus::kFrame);
  source->stop();
  std::this_thread::sleep_for(milliseconds(200));  // longer than the rest of the recording
  const auto begin = Clock::now();
  source->start();
  ASSERT_EQ(source->read(frame, kLong), ReadStatus::kFrame);
  const std::int64_t first_ns = frame.time_ns;
  do {
    // If the first frame has waited since before the stop, the second one begins the time. With a
    // clock that ran on during the pause, all frames would come at once.
    EXPECT_GE(Clock::now() - begin, std::chrono::nanoseconds(frame.time_ns - first_ns - kStep));
  } while (source->read(frame, kLong) == ReadStatus::kFrame);
  EXPECT_EQ(frame.number, 7);
}

TEST(GrabThread, StopsFromAnyThreadAtOnceAndTwice) {
  for (int trial = 0; trial < 20; ++trial) {
    GrabThread source(std::make_unique<FakeCamera>(0));
    source.start();
    std::atomic<int> ended = 0;
    const auto read_to_the_end = [&] {
      RgbdFrame frame;
      ended += source.read(frame, kLong) == ReadStatus::kEnd ? 1 : 0;
    };
    const auto stop_twice = [&] {
      source.stop();
      source.stop();
    };
    const auto begin = Clock::now();
    std::vector<std::thread> threads;
    for (int i = 0; i < 2; ++i) threads.emplace_back(read_to_the_end);
    for (int i = 0; i < 3; ++i) threads.emplace_back(stop_twice);
    for (auto& thread : threads) thread.join();
    EXPECT_EQ(ended, 2);
    EXPECT_LT(Clock::now() - begin, kLong / 2);
  }
}

TEST(GrabThread, StartsAndStopsFromManyThreadsEndInOneState) {
  GrabThread source(std::make_unique<FakeCamera>(-1));
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&source, i] {
      RgbdFrame frame;
      for (int k = 0; k < 50; ++k) {
        if ((i + k) % 2 == 0) source.start();
        source.read(frame, milliseconds(0));
        static_cast<void>(source.counters());
        if ((i + k) % 2 == 1) source.stop();
      }
    });
  }
  for (auto& thread : threads) thread.join();
  source.stop();
  RgbdFrame frame;
  while (source.read(frame, kLong) == ReadStatus::kFrame) {
  }
  EXPECT_EQ(source.read(frame, kLong), ReadStatus::kEnd);
  source.start();
  EXPECT_EQ(source.read(frame, kLong), ReadStatus::kFrame);
}

}  // namespace
}  // namespace manip3d
