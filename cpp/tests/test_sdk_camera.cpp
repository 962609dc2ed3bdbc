#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "capture/sdk_camera.hpp"
#include "manip3d/error.hpp"

// Common parts of the drivers, with a simulated device. Also run under the thread sanitizer.
namespace manip3d {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLong(20'000);
constexpr milliseconds kShort(50);

Intrinsics camera_of(bool mirrored) {
  Intrinsics camera;
  camera.width = 3;
  camera.height = 2;
  camera.fx = camera.fy = 10.0;
  camera.cx = 0.75;
  camera.cy = 0.5;
  camera.mirrored = mirrored;
  return camera;
}

struct Script {
  std::vector<SdkFrame> frames;
  ReadStatus then = ReadStatus::kEnd;
  bool mirrored = false;
  int opened = 0;
};

class ScriptedDevice final : public SdkDevice {
 public:
  explicit ScriptedDevice(Script& script) : script_(script) { ++script_.opened; }
  [[nodiscard]] Intrinsics camera() const override { return camera_of(script_.mirrored); }
  ReadStatus wait(SdkFrame& frame, milliseconds) override {
    if (next_ == script_.frames.size()) return script_.then;
    frame = script_.frames[next_++];
    return ReadStatus::kFrame;
  }

 private:
  Script& script_;
  std::size_t next_ = 0;
};

SdkOpener opener(Script& script) {
  return [&script] { return std::make_unique<ScriptedDevice>(script); };
}

/// Reads all frames of a script, as from a file.
class SdkFile : public testing::Test {
 protected:
  std::vector<RgbdFrame> play(const RgbdOptions& options = {}) {
    source_ = open_sdk_file("test", "/proc/self/exe", opener(script_), options);
    source_->start();
    std::vector<RgbdFrame> frames;
    RgbdFrame frame;
    for (ReadStatus status{}; status != ReadStatus::kEnd;) {
      status = source_->read(frame, kLong);
      if (status == ReadStatus::kFrame) frames.push_back(frame);
    }
    return frames;
  }

  std::map<std::string, std::int64_t> counted() const {
    const Counters counters = source_->counters();
    return {counters.begin(), counters.end()};
  }

  Script script_;
  std::unique_ptr<RgbdSource> source_;
};

// Rows end in padding, which must not be read as pixels.
const std::uint16_t kDepth[] = {4, 5, 6, 999, 0, 65535, 7, 999};

SdkFrame frame_of(std::int64_t number) {
  SdkFrame frame;
  frame.depth = {kDepth, 2, 3, 8, SdkPixels::kDepth16};
  frame.number = number;
  frame.time_ns = 1000 * number;
  return frame;
}

TEST_F(SdkFile, DepthIsBroughtToMillimetres) {
  SdkFrame frame = frame_of(7);
  frame.millimetres = 0.25;
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  constexpr float kInf = std::numeric_limits<float>::infinity();
  const float metres[] = {0.0004F, 0.0006F, kNan, kInf, -1.0F, 65.5351F};
  SdkFrame other = frame_of(8);
  other.depth = {metres, 2, 3, 12, SdkPixels::kDepthFloat};
  other.millimetres = 1000.0;
  script_.frames = {frame, other};
  const auto frames = play();
  ASSERT_EQ(frames.size(), 2U);
  EXPECT_EQ(frames[0].depth, (std::vector<std::uint16_t>{1, 1, 2, 0, 16384, 2}));
  EXPECT_EQ(frames[1].depth, (std::vector<std::uint16_t>{0, 1, 0, 0, 0, 65535}));
  EXPECT_EQ(frames[0].number, 7);
  EXPECT_EQ(frames[0].time_ns, 7000);
  EXPECT_TRUE(frames[0].color.empty());
  EXPECT_EQ(frames[0].calibration->depth.cx, 0.75);
  EXPECT_FALSE(source_->capabilities().is_live);
}

TEST_F(SdkFile, ColorIsRedGreenBlue) {
  std::vector<std::uint8_t> bytes(40);
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::uint8_t>(i);
  const struct {
    SdkPixels pixels;
    std::size_t size, red;
  } kinds[] = {{SdkPixels::kRgb, 3, 0},
               {SdkPixels::kBgr, 3, 2},
               {SdkPixels::kRgbx, 4, 0},
               {SdkPixels::kBgrx, 4, 2}};
  for (const auto& kind : kinds) {
    constexpr std::int64_t kRow = 17;
    SdkFrame frame = frame_of(0);
    frame.color = {bytes.data(), 2, 3, kRow, kind.pixels};
    script_.frames = {frame};
    const auto frames = play();
    ASSERT_EQ(frames.size(), 1U);
    EXPECT_EQ(frames[0].color_cols, 3);
    std::vector<std::uint8_t> expected;
    for (std::size_t v = 0; v < 2; ++v) {
      for (std::size_t u = 0; u < 3; ++u) {
        const std::size_t first = v * kRow + u * kind.size;
        for (const std::size_t i : {kind.red, std::size_t{1}, 2 - kind.red}) {
          expected.push_back(bytes[first + i]);
        }
      }
    }
    EXPECT_EQ(frames[0].color, expected);
  }
}

TEST_F(SdkFile, MirroredImagesAreTurnedRound) {
  script_.mirrored = true;
  const std::uint8_t grey[] = {1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5, 6, 6, 6};
  SdkFrame frame = frame_of(0);
  frame.color = {grey, 2, 3, 9, SdkPixels::kRgb};
  script_.frames = {frame};
  const auto frames = play();
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].depth, (std::vector<std::uint16_t>{6, 5, 4, 7, 65535, 0}));
  EXPECT_EQ(frames[0].color[0], 3);
  EXPECT_FALSE(frames[0].calibration->depth.mirrored);
  EXPECT_EQ(frames[0].calibration->depth.cx, 2.0 - 0.75);
}

TEST_F(SdkFile, WhatDoesNotFitIsCounted) {
  SdkFrame large = frame_of(3), none = frame_of(4), color = frame_of(7);
  large.depth.rows = 3;
  none.depth.data = nullptr;
  color.color = {kDepth, 1, 2, 6, SdkPixels::kRgb};
  script_.frames = {frame_of(2), large, none, color};
  EXPECT_EQ(play().size(), 2U);
  EXPECT_EQ(counted(),
            (std::map<std::string, std::int64_t>{
                {"frames", 2}, {"lost_by_camera", 4}, {"without_color", 2}, {"damaged", 2}}));
}

TEST_F(SdkFile, TheGivenCameraIsTaken) {
  const auto given = std::make_shared<RgbdCalibration>();
  given->depth = camera_of(false);
  given->depth.fx = 77.0;
  script_.frames = {frame_of(0), frame_of(1)};
  EXPECT_EQ(play({.calibration = given}).at(0).calibration, given);
  RgbdOptions real_time;
  real_time.speed = 1.0;
  EXPECT_EQ(play(real_time).back().number, 1);
  EXPECT_TRUE(source_->capabilities().is_live);
  EXPECT_THROW(open_sdk_file("test", "/no/such/file.bag", opener(script_), {}),
               std::filesystem::filesystem_error);
}

TEST_F(SdkFile, AGivenRegistrationIsIgnored) {
  const auto given = std::make_shared<RgbdCalibration>();
  given->depth = camera_of(false);
  given->depth.fx = 77.0;
  given->registration = Registration{};
  script_.frames = {frame_of(0)};
  const auto frames = play({.calibration = given});
  EXPECT_FALSE(frames.at(0).calibration->registration.has_value());
  EXPECT_EQ(frames.at(0).calibration->depth.fx, 77.0);
}

TEST(SdkCamera, SilenceIsUnpluggedAndItCanBeOpenedAgain) {
  Script script{.frames = {frame_of(0)}, .then = ReadStatus::kTimeout};
  const auto source = open_sdk_camera("test", opener(script), {}, kShort);
  source->start();
  RgbdFrame frame;
  ASSERT_EQ(source->read(frame, kLong), ReadStatus::kFrame);
  try {
    source->read(frame, kLong);
    FAIL();
  } catch (const DeviceError& error) {
    EXPECT_STREQ(error.what(), "test: no images for 50 ms: unplugged?");
  }
  source->start();
  EXPECT_EQ(source->read(frame, kLong), ReadStatus::kFrame);
  EXPECT_EQ(script.opened, 2);
  source->stop();
}

TEST(SdkCamera, ALensOutOfRangeIsRefused) {
  class Blind final : public SdkDevice {
   public:
    [[nodiscard]] Intrinsics camera() const override { return {}; }
    ReadStatus wait(SdkFrame&, milliseconds) override { return ReadStatus::kTimeout; }
  };
  const auto source = open_sdk_camera("test", [] { return std::make_unique<Blind>(); }, {}, kShort);
  EXPECT_THROW(source->start(), InputError);
}

TEST(SdkLocation, OptionsFollowThePlace) {
  const SdkLocation at = parse_sdk_location("test", "A1?rate=30", {"rate", "width"});
  EXPECT_EQ(at.place, "A1");
  EXPECT_EQ(at.options, (std::map<std::string, int>{{"rate", 30}, {"width", 0}}));
  EXPECT_EQ(parse_sdk_location("test", "", {"rate"}).options.at("rate"), 0);
  EXPECT_EQ(parse_sdk_location("test", "?width=5&rate=6", {"rate", "width"}).options.at("width"),
            5);
  for (const char* wrong : {"?rat=30", "?rate", "?rate=", "?rate=0", "?rate=-3", "?rate=3x",
                            "?rate=9999999999", "?=3", "?rate=1&&width=3"}) {
    EXPECT_THROW(parse_sdk_location("test", wrong, {"rate", "width"}), InputError) << wrong;
  }
}

TEST(SdkCall, WhatTheFunctionSaysIsThrown) {
  const auto raise = [](std::string* error) {
    if (error != nullptr) throw DeviceError(*error);
  };
  static std::string told = "no";
  const auto half = [](int value, std::string** error) {
    if (value % 2 != 0) *error = &told;
    return value / 2;
  };
  EXPECT_EQ(sdk_call<std::string>(raise, half, 8), 4);
  EXPECT_THROW(sdk_call<std::string>(raise, half, 7), DeviceError);
}

}  // namespace
}  // namespace manip3d
