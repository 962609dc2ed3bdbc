#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "capture/azure_calibration.hpp"
#include "capture/jpeg.hpp"
#include "capture/raw_color.hpp"
#include "ffmpeg.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"
#include "parse/json_text.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

// Rounded parameters of a real sensor.
constexpr double kDepthLens[] = {0.50127, 0.50320, 0.49252, 0.49259, 6.08415, 4.37549,  0.23619,
                                 6.40873, 6.41830, 1.22029, 0.0,     0.0,     6.503e-5, -5.530e-5};
constexpr double kColorLens[] = {0.49866,  0.50207, 0.47819,    0.63736,  0.58438,
                                 -2.49425, 1.36028, 0.46476,    -2.33625, 1.30116,
                                 0.0,      0.0,     -1.7651e-4, 6.5308e-4};

JsonPlace::Json camera_json(const char* location, const double (&lens)[14],
                            const std::vector<double>& rotation,
                            const std::vector<double>& translation) {
  return {{"Location", location},
          {"Intrinsics",
           {{"ModelType", "CALIBRATION_LensDistortionModelBrownConrady"},
            {"ModelParameterCount", 14},
            {"ModelParameters", lens}}},
          {"MetricRadius", 1.74},
          {"Rt", {{"Rotation", rotation}, {"Translation", translation}}}};
}

JsonPlace::Json calibration_json() {
  const JsonPlace::Json cameras = {camera_json("CALIBRATION_CameraLocationD0", kDepthLens,
                                               {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}),
                                   camera_json("CALIBRATION_CameraLocationPV0", kColorLens,
                                               {1, 0, 0, 0, 0.99518, -0.09806, 0, 0.09806, 0.99518},
                                               {-0.0320, -0.0021, 0.0039})};
  return {{"CalibrationInformation", {{"Cameras", cameras}}}};
}

/// OpenCV's rational model as printed in its manual, with the parameters in the order of the lens.
Eigen::Vector2d pixel_of(const double (&l)[14], double width, double height, double left,
                         double top, const Eigen::Vector2d& ray) {
  const double x = ray.x(), y = ray.y(), r2 = x * x + y * y, r4 = r2 * r2, r6 = r4 * r2;
  const double radial =
      (1 + l[4] * r2 + l[5] * r4 + l[6] * r6) / (1 + l[7] * r2 + l[8] * r4 + l[9] * r6);
  const double p2 = l[12], p1 = l[13];
  const double xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
  const double yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y;
  return {(l[2] * xd + l[0]) * width - left - 0.5, (l[3] * yd + l[1]) * height - top - 0.5};
}

std::shared_ptr<RgbdCalibration> calibration_of(ImageSize depth, std::optional<ImageSize> color,
                                                const JsonPlace::Json& json = calibration_json()) {
  return azure_calibration(JsonPlace(json, "calibration.json", 0), depth, color);
}

TEST(AzureCalibration, RaysOfTheDepthCameraSeeTheirPixels) {
  struct Mode {
    ImageSize size;
    double side, left, top;
  };
  for (const Mode& mode : {Mode{{576, 640}, 1024, 192, 180}, Mode{{288, 320}, 512, 96, 90},
                           Mode{{512, 512}, 512, 0, 0}}) {
    const auto calibration = calibration_of(mode.size, std::nullopt);
    ASSERT_EQ(std::ssize(calibration->ray_table), 2 * mode.size.rows * mode.size.cols);
    std::int64_t known = 0;
    for (std::int64_t i = 0; i < mode.size.rows * mode.size.cols; i += 7) {
      const float x = calibration->ray_table[2 * i];
      const float y = calibration->ray_table[2 * i + 1];
      if (std::isnan(x)) continue;
      ++known;
      const Eigen::Vector2d pixel =
          pixel_of(kDepthLens, mode.side, mode.side, mode.left, mode.top, {x, y});
      EXPECT_NEAR(pixel.x(), static_cast<double>(i % mode.size.cols), 1e-3);
      EXPECT_NEAR(pixel.y(), static_cast<double>(i / mode.size.cols), 1e-3);
    }
    // The wide view is a circle; the corners are blank.
    EXPECT_GT(known, mode.size.rows * mode.size.cols / 7 * (mode.left > 0 ? 99 : 75) / 100);
  }
}

TEST(AzureCalibration, BrownsModelIsNearTheColorLens) {
  const ImageSize size{720, 1280};
  const auto calibration = calibration_of({576, 640}, size);
  const Registration& registration = *calibration->registration;
  double most = 0.0;
  for (double x = -0.7; x <= 0.7; x += 0.02) {
    for (double y = -0.4; y <= 0.4; y += 0.02) {
      const Eigen::Vector2d expected = pixel_of(kColorLens, 1280, 960, 0, 120, {x, y});
      if (expected.x() < 0 || expected.y() < 0 || expected.x() > 1279 || expected.y() > 719) {
        continue;
      }
      const Eigen::Vector2d pixel = project(registration.color, {x, y, 1.0});
      most = std::max(most, (pixel - expected).norm());
    }
  }
  RecordProperty("pixels", std::to_string(most));
  EXPECT_LT(most, 1.0);  // 0.62, in a corner
  EXPECT_NEAR(registration.translation.x(), -0.0320, 1e-12);
  EXPECT_NEAR(registration.rotation(1, 2), -0.09806, 1e-12);  // row by row
}

TEST(AzureCalibration, ARadiusOfZeroIsTheOneOfTheSdk) {
  auto json = calibration_json();
  for (auto& camera : json["CalibrationInformation"]["Cameras"]) camera["MetricRadius"] = 1.7;
  const auto expected = calibration_of({576, 640}, ImageSize{720, 1280}, json);
  for (auto& camera : json["CalibrationInformation"]["Cameras"]) camera["MetricRadius"] = 0;
  const auto found = calibration_of({576, 640}, ImageSize{720, 1280}, json);
  EXPECT_EQ(found->registration->color.distortion, expected->registration->color.distortion);
  EXPECT_GT(std::abs(found->registration->color.distortion[0]), 0.01);
  EXPECT_TRUE(std::ranges::equal(found->ray_table, expected->ray_table, [](float a, float b) {
    return a == b || (std::isnan(a) && std::isnan(b));
  }));
}

TEST(AzureCalibration, ALensThatHoldsNowhereIsAnErrorAndNotNoDistortion) {
  for (const std::size_t camera : {0U, 1U}) {
    auto json = calibration_json();
    json["CalibrationInformation"]["Cameras"][camera]["MetricRadius"] = 1e-3;
    try {
      calibration_of({576, 640}, ImageSize{720, 1280}, json);
      FAIL() << camera;
    } catch (const FormatError& error) {
      EXPECT_NE(error.reason().find("the model of its lens holds for less than half"),
                std::string::npos);
    }
  }
}

TEST(AzureCalibration, RefusesWhatItDoesNotKnow) {
  EXPECT_THROW(calibration_of({480, 640}, std::nullopt), FormatError);
  EXPECT_THROW(calibration_of({576, 640}, std::nullopt, JsonPlace::Json::object()), FormatError);
  auto json = calibration_json();
  json["CalibrationInformation"]["Cameras"][0]["Intrinsics"]["ModelParameters"][2] = 0.0;
  EXPECT_THROW(calibration_of({576, 640}, std::nullopt, json), FormatError);
  json = calibration_json();
  json["CalibrationInformation"]["Cameras"][0]["Intrinsics"]["ModelType"] = "Theta";
  EXPECT_THROW(calibration_of({576, 640}, std::nullopt, json), FormatError);
  json = calibration_json();
  json["CalibrationInformation"]["Cameras"][1]["Rt"]["Rotation"][0] = 7.0;
  EXPECT_THROW(calibration_of({576, 640}, ImageSize{720, 1280}, json), FormatError);
}

// --- a recording, written without FFmpeg --------------------------------------------------------

using Bytes = std::string;

Bytes number(std::uint64_t value, int bytes) {
  Bytes result;
  for (int i = bytes - 1; i >= 0; --i) result += static_cast<char>(value >> (8 * i));
  return result;
}

/// RFC 8794: identifier, length in eight bytes, content.
Bytes element(std::uint32_t id, const Bytes& content) {
  const int id_bytes = id > 0xffffff ? 4 : id > 0xffff ? 3 : id > 0xff ? 2 : 1;
  return number(id, id_bytes) + number(content.size() | (std::uint64_t{1} << 56), 8) + content;
}

Bytes element(std::uint32_t id, std::uint64_t value) { return element(id, number(value, 8)); }

Bytes video_track(std::uint64_t track, const char* name, const char* fourcc, ImageSize size) {
  const auto cols = static_cast<std::uint64_t>(size.cols);
  const auto rows = static_cast<std::uint64_t>(size.rows);
  const auto little = [](std::uint64_t value) {
    const Bytes big = number(value, 4);
    return Bytes(big.rbegin(), big.rend());
  };
  const Bytes bitmap_header =
      little(40) + little(cols) + little(rows) + Bytes("\1\0\20\0", 4) + fourcc + Bytes(20, '\0');
  return element(0xAE, element(0xD7, track) + element(0x73C5, track) + element(0x83, 1) +
                           element(0x536E, name) + element(0x86, "V_MS/VFW/FOURCC") +
                           element(0x63A2, bitmap_header) + element(0x23E383, 33'333'333) +
                           element(0xE0, element(0xB0, cols) + element(0xBA, rows)));
}

struct Block {
  std::uint64_t track;
  std::uint64_t time_us;
  Bytes data;
};

Bytes recording(const std::vector<Block>& blocks, ImageSize depth, ImageSize color,
                const char* color_kind = "MJPG", const char* offset_ns = "1000000500",
                double duration_ms = 0.0) {
  const Bytes tracks = element(0x1654AE6B, video_track(1, "COLOR", color_kind, color) +
                                               video_track(2, "DEPTH", "b16g", depth) +
                                               video_track(3, "IR", "b16g", depth));
  const Bytes attached =
      element(0x1941A469,
              element(0x61A7, element(0x466E, "calibration.json") +
                                  element(0x4660, "application/octet-stream") +
                                  element(0x465C, calibration_json().dump()) + element(0x46AE, 1)));
  const Bytes tags = element(
      0x1254C367, element(0x7373, element(0x63C0, Bytes()) +
                                      element(0x67C8, element(0x45A3, "K4A_START_OFFSET_NS") +
                                                          element(0x4487, offset_ns))));
  // In units of the time scale above, which are microseconds.
  const Bytes duration =
      duration_ms > 0.0
          ? element(0x4489, number(std::bit_cast<std::uint64_t>(1000.0 * duration_ms), 8))
          : Bytes();
  Bytes clusters;
  for (const Block& block : blocks) {
    clusters += element(0x1F43B675, element(0xE7, block.time_us) +
                                        element(0xA3, number(0x80 | block.track, 1) + number(0, 2) +
                                                          number(0x80, 1) + block.data));
  }
  return element(0x1A45DFA3,
                 element(0x4282, "matroska") + element(0x4287, 4) + element(0x4285, 2)) +
         element(0x18538067, element(0x1549A966, element(0x2AD7B1, 1000) + duration) + tracks +
                                 attached + tags + clusters);
}

Bytes depth_block(ImageSize size, int seed) {
  Bytes data;
  for (std::int64_t i = 0; i < size.rows * size.cols; ++i) {
    data += number(static_cast<std::uint64_t>(i * 7 + seed) & 0xffff, 2);
  }
  return data;
}

class AzureMkv : public ::testing::Test {
 protected:
  void SetUp() override {
    set_mkv_loader([] { return FoundMkvCodec{&ffmpeg_mkv_codec(), "", ""}; });
    path_ = fs::temp_directory_path() / ("manip3d-azure-" + std::to_string(::getpid()) + ".mkv");
    JpegEncoder encoder(90);
    const std::vector<std::uint8_t> grey(3 * 64 * 48, 90);
    const auto packet = encoder.encode(grey.data(), kColor);
    jpeg_.assign(reinterpret_cast<const char*>(packet.data()), packet.size());
  }
  void TearDown() override {
    if (!path_.empty()) fs::remove(path_);
  }
  void write(const Bytes& bytes) { std::ofstream(path_, std::ios::binary) << bytes; }

  static constexpr ImageSize kDepth{288, 320};
  static constexpr ImageSize kColor{48, 64};
  fs::path path_;
  Bytes jpeg_;
};

TEST_F(AzureMkv, PairsImagesByTheirTimes) {
  const Bytes noise(jpeg_.size(), '\x55');
  write(recording(
      {
          {2, 0, depth_block(kDepth, 0)},           // before any colour image
          {1, 31'000, jpeg_},                       // 2 ms before its depth
          {2, 33'000, depth_block(kDepth, 1)},      //
          {3, 33'000, depth_block(kDepth, 99)},     // infrared
          {2, 66'000, depth_block(kDepth, 2)},      // the colour comes later
          {1, 69'000, jpeg_},                       //
          {2, 100'000, depth_block(kDepth, 3)},     //
          {1, 100'000, noise},                      // not a JPEG image
          {2, 133'000, Bytes(100, '\0')},           // too short
          {2, 166'000, depth_block(kDepth, 5)},     //
          {1, 166'000, jpeg_.substr(0, 300)},       // cut short
          {2, 200'123, depth_block(kDepth, 65535)}  //
      },
      kDepth, kColor));
  const auto source = open_mkv(path_);
  RgbdFrame frame;
  struct Expected {
    std::int64_t number, time_us;
    bool has_color;
    int seed;
  };
  for (const Expected& expected :
       {Expected{0, 0, false, 0}, Expected{1, 33'000, true, 1}, Expected{2, 66'000, true, 2},
        Expected{6, 200'123, false, 65535}}) {
    ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
    EXPECT_EQ(frame.number, expected.number);
    EXPECT_EQ(frame.time_ns, expected.time_us * 1000 + 1'000'000'500);
    EXPECT_EQ(!frame.color.empty(), expected.has_color);
    ASSERT_EQ(std::ssize(frame.depth), kDepth.rows * kDepth.cols);
    for (std::size_t i = 0; i < frame.depth.size(); ++i) {
      ASSERT_EQ(frame.depth[i],
                static_cast<std::uint16_t>(i * 7 + static_cast<unsigned>(expected.seed)));
    }
    EXPECT_EQ(expected.has_color ? frame.color.at(0) : 90, 90);
  }
  EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd);
  const Counters counters = source->counters();
  const std::map<std::string, std::int64_t> counted(counters.begin(), counters.end());
  EXPECT_EQ(counted.at("frames"), 4);
  EXPECT_EQ(counted.at("without_color"), 2);
  EXPECT_EQ(counted.at("damaged"), 3);
  EXPECT_EQ(source->calibration()->depth.width, 320);
  EXPECT_EQ(source->calibration()->registration->color.width, 64);
}

TEST_F(AzureMkv, LeavesOutColorsOfAnotherSizeWithoutARegistration) {
  write(recording({{2, 0, depth_block(kDepth, 0)}, {1, 0, jpeg_}}, kDepth, kColor));
  auto camera = std::make_shared<RgbdCalibration>();
  camera->depth = {.width = 320, .height = 288, .fx = 250, .fy = 250, .cx = 159.5, .cy = 143.5};
  const auto source = open_mkv(path_, {.calibration = camera});
  RgbdFrame frame;
  ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
  EXPECT_TRUE(frame.color.empty());
  EXPECT_EQ(frame.color_rows, 0);
  EXPECT_EQ(std::ssize(frame.depth), kDepth.rows * kDepth.cols);
  EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd);
  const Counters counters = source->counters();
  const std::map<std::string, std::int64_t> counted(counters.begin(), counters.end());
  EXPECT_EQ(counted.at("unregistered_color"), 1);
  EXPECT_EQ(counted.at("without_color"), 0);
}

TEST_F(AzureMkv, GoesToAFrameByItsIndex) {
  std::vector<Block> blocks;
  for (int i = 0; i < 9; ++i) {
    const std::uint64_t time_us = 33'000U * static_cast<unsigned>(i);
    if (i % 2 == 0) blocks.push_back({1, time_us, jpeg_});
    blocks.push_back({2, time_us, i == 4 ? Bytes(100, '\0') : depth_block(kDepth, i)});
  }
  write(recording(blocks, kDepth, kColor));
  const auto source = open_mkv(path_);
  RgbdFrame frame;
  for (const int index : {5, 2, 3, 8, 0}) {
    source->read_at(index, frame);
    EXPECT_EQ(frame.number, index);
    EXPECT_EQ(frame.depth.front(), index);
    EXPECT_EQ(frame.color.empty(), index % 2 != 0);
  }
  source->seek(7);
  ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
  EXPECT_EQ(frame.number, 7);
  EXPECT_THROW(source->read_at(4, frame), FormatError);  // its image is too short
  ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
  EXPECT_EQ(frame.number, 5);
  EXPECT_THROW(source->read_at(9, frame), InputError);
  EXPECT_THROW(source->seek(-1), InputError);
}

TEST_F(AzureMkv, OffsetsOfTheClockNeverOverflow) {
  const std::uint64_t latest = std::uint64_t{1} << 62;  // microseconds: later than valid times
  RgbdFrame frame;
  for (const char* offset : {"2251799813685247000", "-2251799813685247000", "0"}) {
    write(recording({{2, latest, depth_block(kDepth, 0)}}, kDepth, kColor, "MJPG", offset));
    const auto source = open_mkv(path_);
    ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
    EXPECT_EQ(frame.time_ns, (std::int64_t{1} << 51) * 1000 + std::stoll(offset));
  }
  for (const char* offset : {"9223372036854775807", "-9223372036854775808", "1e9", "12 s",
                             "99999999999999999999", "2251799813686000000"}) {
    write(recording({{2, 0, depth_block(kDepth, 0)}}, kDepth, kColor, "MJPG", offset));
    try {
      open_mkv(path_);
      FAIL() << offset;
    } catch (const FormatError& error) {
      EXPECT_NE(error.reason().find(std::string("got ") + offset), std::string::npos);
    }
  }
}

TEST_F(AzureMkv, ReadsColorsThatAreNotCompressed) {
  // Red of ITU-R BT.601: Y 81, U 90, V 240.
  const Bytes luma(64 * 48, 81);
  const auto repeated = [](const Bytes& bytes, int times) {
    Bytes all;
    for (int i = 0; i < times; ++i) all += bytes;
    return all;
  };
  const std::map<const char*, Bytes> images = {
      {"NV12", luma + repeated("\x5A\xF0", 32 * 24)},
      {"YUY2", repeated("\x51\x5A\x51\xF0", 32 * 48)},
      {"BGRA", repeated(Bytes("\x00\x00\xFF\x00", 4), 64 * 48)},
  };
  for (const auto& [kind, image] : images) {
    write(recording({{2, 0, depth_block(kDepth, 0)},
                     {1, 0, image},
                     {2, 33'000, depth_block(kDepth, 1)},
                     {1, 33'000, image.substr(1)}},
                    kDepth, kColor, kind));
    const auto source = open_mkv(path_);
    RgbdFrame frame;
    ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame) << kind;
    ASSERT_EQ(std::ssize(frame.color), 3 * kColor.rows * kColor.cols) << kind;
    for (std::size_t i = 0; i < frame.color.size(); ++i) {
      ASSERT_NEAR(frame.color[i], i % 3 == 0 ? 255 : 0, 1) << kind << ' ' << i;
    }
    EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd) << kind;  // an image that is too short
    const Counters counters = source->counters();
    const std::map<std::string, std::int64_t> counted(counters.begin(), counters.end());
    EXPECT_EQ(counted.at("damaged"), 1) << kind;
    EXPECT_FALSE(counted.contains("cut_short")) << kind;  // this file states no duration
  }
}

TEST_F(AzureMkv, PixelsOfUncompressedColorsAreInTheirOrder) {
  const auto decoded = [](RawColor layout, const Bytes& image, ImageSize size) {
    std::vector<std::uint8_t> rgb(3 * size.rows * size.cols);
    decode_raw_color(layout, std::as_bytes(std::span(image)), size, rgb.data());
    return rgb;
  };
  const auto greys = [](std::initializer_list<int> levels) {
    std::vector<std::uint8_t> rgb;
    for (const int level : levels) rgb.insert(rgb.end(), 3, static_cast<std::uint8_t>(level));
    return rgb;
  };
  // Lumas of black, dark grey, light grey and white.
  EXPECT_EQ(decoded(RawColor::kNv12, Bytes("\x10\x35\xC0\xEB\x80\x80", 6), {2, 2}),
            greys({0, 43, 205, 255}));
  EXPECT_EQ(decoded(RawColor::kYuy2, Bytes("\x10\x80\x35\x80\xC0\x80\xEB\x80", 8), {2, 2}),
            greys({0, 43, 205, 255}));
  EXPECT_EQ(decoded(RawColor::kBgra, Bytes("\x03\x02\x01\x00\x06\x05\x04\x00", 8), {1, 2}),
            (std::vector<std::uint8_t>{1, 2, 3, 4, 5, 6}));
  EXPECT_THROW(decoded(RawColor::kYuy2, Bytes(6, '\0'), {1, 3}), FormatError);
  EXPECT_THROW(decoded(RawColor::kNv12, Bytes(9, '\0'), {3, 2}), FormatError);
  EXPECT_THROW(decoded(RawColor::kBgra, Bytes(9, '\0'), {1, 2}), FormatError);
}

TEST_F(AzureMkv, ARecordingWhoseLastDepthImagesAreMissingIsCutShort) {
  for (const auto& [duration_ms, is_cut] : {std::pair{100.0, false}, std::pair{400.0, true}}) {
    write(recording({{2, 0, depth_block(kDepth, 0)}, {2, 66'000, depth_block(kDepth, 1)}}, kDepth,
                    kColor, "MJPG", "0", duration_ms));
    const auto source = open_mkv(path_);
    RgbdFrame frame;
    while (source->read(frame, 0ms) == ReadStatus::kFrame) continue;
    const Counters counters = source->counters();
    const std::map<std::string, std::int64_t> counted(counters.begin(), counters.end());
    EXPECT_EQ(counted.contains("cut_short"), is_cut) << duration_ms;
  }
}

TEST_F(AzureMkv, ARecordingWithoutDepthIsNotCalledDamaged) {
  const Bytes whole = recording({{1, 0, jpeg_}}, kDepth, kColor);
  const auto reason_of = [&](const Bytes& bytes) -> std::string {
    write(bytes);
    try {
      open_mkv(path_);
    } catch (const FormatError& error) {
      return error.reason();
    }
    return "";
  };
  Bytes passive = whole;
  passive.replace(passive.find("DEPTH"), 5, "OTHER");
  EXPECT_EQ(reason_of(passive),
            "a recording of an Azure Kinect without depth images: its depth mode was passive "
            "infrared or off");
  Bytes film = passive;
  film.replace(film.find("K4A_START"), 9, "SOMETHING");
  EXPECT_NE(reason_of(film).find("this file holds no depth images"), std::string::npos);
}

TEST_F(AzureMkv, RefusesOtherKindsOfImages) {
  write(recording({{2, 0, depth_block(kDepth, 0)}}, kDepth, kColor, "I420"));
  EXPECT_THROW(open_mkv(path_), FormatError);
  write(recording({{2, 0, depth_block(kDepth, 0)}}, {100, 100}, kColor));
  EXPECT_THROW(open_mkv(path_), FormatError);
  write(recording({{2, 0, depth_block(kDepth, 0)}}, {100'000, 100'000}, kColor));
  EXPECT_THROW(open_mkv(path_), FormatError);
}

}  // namespace
}  // namespace manip3d
