#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <thread>

#include "capture/ffv1.hpp"
#include "capture/matroska.hpp"
#include "capture/mkv_library.hpp"
#include "capture/sha256.hpp"
#include "ffmpeg.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

#ifdef __SANITIZE_THREAD__  // ten times slower, and only one thread reads the damaged files
constexpr std::uint64_t kThinning = 8;
#else
constexpr std::uint64_t kThinning = 1;
#endif

class Mkv : public ::testing::Test {
 protected:
  void SetUp() override {
    set_mkv_loader([] { return FoundMkvCodec{&ffmpeg_mkv_codec(), "", ""}; });
    folder_ = fs::temp_directory_path() / ("manip3d-mkv-" + std::to_string(::getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override {
    if (!folder_.empty()) fs::remove_all(folder_);
  }
  fs::path folder_;
};

struct Shape {
  std::int64_t rows = 24, cols = 32;
  std::int64_t color_rows = 0, color_cols = 0;  // 0: no colour
  bool body_index = true;
  int skeletons = 1;
};

std::shared_ptr<const RgbdCalibration> calibration_of(const Shape& shape, bool rays = false) {
  auto calibration = std::make_shared<RgbdCalibration>();
  calibration->depth = {shape.cols, shape.rows, 365.1, 364.9, 15.3, 11.7};
  if (rays) {
    for (std::int64_t i = 0; i < 2 * shape.rows * shape.cols; ++i) {
      calibration->ray_table.push_back(0.001F * static_cast<float>(i));
    }
    calibration->ray_table[7] = std::numeric_limits<float>::quiet_NaN();
    calibration->depth.ray_table = calibration->ray_table.data();
  }
  if (shape.color_rows > 0) {
    Registration registration;
    registration.color = {shape.color_cols, shape.color_rows, 1081.37, 1081.5, 959.5, 539.5};
    registration.translation = {0.052, 1.0 / 3.0, 0.0};
    calibration->registration = registration;
  }
  return calibration;
}

/// A slope with noise, a hole and a person-like blob that moves.
RgbdFrame frame_of(const Shape& shape, std::int64_t number,
                   std::shared_ptr<const RgbdCalibration> calibration) {
  RgbdFrame frame;
  frame.number = number;
  frame.time_ns = 1'600'000'000'000'000'000 + number * 33'366'701;
  frame.rows = shape.rows;
  frame.cols = shape.cols;
  frame.calibration = std::move(calibration);
  for (std::int64_t v = 0; v < shape.rows; ++v) {
    for (std::int64_t u = 0; u < shape.cols; ++u) {
      const bool inside = (u + number) % shape.cols < shape.cols / 3;
      const auto noise = static_cast<std::int64_t>(
          random_bits(static_cast<std::uint64_t>(number), frame.depth.size()) % 8);
      frame.depth.push_back(
          static_cast<std::uint16_t>(u == 0 ? 0 : (inside ? 1500 : 60000) + 3 * v + noise));
      if (shape.body_index) frame.body_index.push_back(inside ? 0 : kNoBody);
    }
  }
  frame.color_rows = shape.color_rows;
  frame.color_cols = shape.color_cols;
  for (std::int64_t i = 0; i < 3 * shape.color_rows * shape.color_cols; ++i) {
    frame.color.push_back(static_cast<std::uint8_t>(i / 7 + number + (i % 3) * 40));
  }
  for (int s = 0; s < shape.skeletons; ++s) {
    Skeleton skeleton;
    skeleton.id = 72057594037927936 + s;
    skeleton.body = static_cast<std::uint8_t>(s);
    for (std::size_t j = 0; j < kNumJoints; ++j) {
      skeleton.positions[j] = Eigen::Vector3f(0.1F, -0.2F, 2.4F) * static_cast<float>(j + 1);
      skeleton.orientations[j] = {0.6F, -0.0F, 1e-42F, 0.8F};
      skeleton.states[j] = static_cast<TrackingState>(j % 3);
    }
    skeleton.positions[3].x() = std::numeric_limits<float>::infinity();
    skeleton.positions[4].y() = std::numeric_limits<float>::quiet_NaN();
    frame.skeletons.push_back(skeleton);
  }
  return frame;
}

template <typename T>
bool same_bits(const T& a, const T& b) {
  return std::memcmp(&a, &b, sizeof(T)) == 0;
}

void expect_same_but_color(const RgbdFrame& a, const RgbdFrame& b) {
  EXPECT_EQ(a.number, b.number);
  EXPECT_EQ(a.time_ns, b.time_ns);
  EXPECT_EQ(a.rows, b.rows);
  EXPECT_EQ(a.cols, b.cols);
  EXPECT_TRUE(a.depth == b.depth);
  EXPECT_TRUE(a.body_index == b.body_index);
  EXPECT_EQ(a.color_rows, b.color_rows);
  EXPECT_EQ(a.color_cols, b.color_cols);
  ASSERT_EQ(a.skeletons.size(), b.skeletons.size());
  for (std::size_t s = 0; s < a.skeletons.size(); ++s) {
    EXPECT_TRUE(same_bits(a.skeletons[s].positions, b.skeletons[s].positions));
    EXPECT_TRUE(same_bits(a.skeletons[s].orientations, b.skeletons[s].orientations));
    EXPECT_TRUE(same_bits(a.skeletons[s].states, b.skeletons[s].states));
    EXPECT_EQ(a.skeletons[s].id, b.skeletons[s].id);
    EXPECT_EQ(a.skeletons[s].body, b.skeletons[s].body);
  }
}

/// The colour of a frame after JPEG compression.
std::vector<std::uint8_t> through_jpeg(const RgbdFrame& frame, int quality) {
  JpegEncoder encoder(quality);
  std::vector<std::uint8_t> color(frame.color.size());
  const ImageSize size{frame.color_rows, frame.color_cols};
  JpegDecoder().decode(encoder.encode(frame.color.data(), size), size, color.data());
  return color;
}

void record(const fs::path& path, const Shape& shape, std::int64_t count,
            const RecorderOptions& options = {}) {
  const auto calibration = calibration_of(shape);
  const auto recorder = record_mkv(path, calibration, options);
  for (std::int64_t n = 0; n < count; ++n) recorder->write(frame_of(shape, n, calibration));
  recorder->close();
}

std::map<std::string, std::int64_t> counted(const RgbdSource& source) {
  const Counters counters = source.counters();
  return {counters.begin(), counters.end()};
}

/// Reads all frames; each must equal the frame with its number.
std::vector<std::int64_t> replay(RgbdSource& source, const Shape& shape) {
  std::vector<std::int64_t> numbers;
  RgbdFrame frame;
  while (source.read(frame, 0ms) == ReadStatus::kFrame) {
    expect_same_but_color(frame, frame_of(shape, frame.number, {}));
    numbers.push_back(frame.number);
  }
  return numbers;
}

std::vector<char> bytes_of_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_bytes(const fs::path& path, const char* data, std::size_t size) {
  std::ofstream(path, std::ios::binary).write(data, static_cast<std::streamsize>(size));
}

TEST_F(Mkv, ReplaysWhatWasRecordedBitForBit) {
  const Shape shapes[] = {
      {},
      {.color_rows = 24, .color_cols = 32},
      {.color_rows = 54, .color_cols = 96, .skeletons = 6},
      {.rows = 7, .cols = 13, .color_rows = 5, .color_cols = 4, .body_index = false},
      {.rows = 4, .cols = 4, .color_rows = 4, .color_cols = 4, .skeletons = 0},
      {.rows = 424, .cols = 512, .color_rows = 424, .color_cols = 512},
  };
  int file = 0;
  for (const Shape& shape : shapes) {
    for (const bool lossless : {false, true}) {
      SCOPED_TRACE(file);
      const fs::path path = folder_ / (std::to_string(file++) + ".mkv");
      const auto calibration = calibration_of(shape);
      const auto recorder =
          record_mkv(path, calibration, {.lossless_color = lossless, .jpeg_quality = 80});
      for (int n = 0; n < 5; ++n) recorder->write(frame_of(shape, n, calibration));
      recorder->close();
      recorder->close();
      const auto source = open_mkv(path);
      EXPECT_EQ(source->num_frames(), 5);
      RgbdFrame frame;
      for (int n = 0; n < 5; ++n) {
        ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
        const RgbdFrame expected = frame_of(shape, n, calibration);
        expect_same_but_color(frame, expected);
        EXPECT_TRUE(
            frame.color ==
            (lossless || expected.color.empty() ? expected.color : through_jpeg(expected, 80)));
        EXPECT_EQ(frame.calibration, source->calibration());
      }
      EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd);
      EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd);
      const std::map<std::string, std::int64_t> expected = {
          {"frames", 5}, {"damaged", 0}, {"lost", 0}, {"cut_short", 0}, {"unfinished", 0}};
      EXPECT_EQ(counted(*source), expected);
    }
  }
}

void expect_same_calibration(const RgbdCalibration& a, const RgbdCalibration& b) {
  const auto expect_same = [](const Intrinsics& x, const Intrinsics& y) {
    EXPECT_EQ(x.width, y.width);
    EXPECT_EQ(x.height, y.height);
    EXPECT_EQ(x.fx, y.fx);
    EXPECT_EQ(x.fy, y.fy);
    EXPECT_EQ(x.cx, y.cx);
    EXPECT_EQ(x.cy, y.cy);
    EXPECT_EQ(x.distortion, y.distortion);
  };
  expect_same(a.depth, b.depth);
  EXPECT_EQ(a.depth.ray_table == nullptr, b.depth.ray_table == nullptr);
  ASSERT_EQ(a.ray_table.size(), b.ray_table.size());
  for (std::size_t i = 0; i < a.ray_table.size(); ++i) {
    EXPECT_TRUE(same_bits(a.ray_table[i], b.ray_table[i]));
  }
  ASSERT_EQ(a.registration.has_value(), b.registration.has_value());
  if (!a.registration) return;
  expect_same(a.registration->color, b.registration->color);
  EXPECT_EQ(a.registration->rotation, b.registration->rotation);
  EXPECT_EQ(a.registration->translation, b.registration->translation);
}

TEST_F(Mkv, KeepsTheCalibrationWithItsRayTable) {
  const Shape shape{.color_rows = 54, .color_cols = 96};
  const auto calibration = calibration_of(shape, true);
  const fs::path path = folder_ / "rays.mkv";
  const auto recorder = record_mkv(path, calibration);
  recorder->close();  // without frames
  const auto source = open_mkv(path);
  expect_same_calibration(*source->calibration(), *calibration);
  RgbdFrame frame;
  EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd);
  const auto other = calibration_of(shape);
  EXPECT_EQ(open_mkv(path, {.calibration = other})->calibration(), other);
}

TEST_F(Mkv, FramesMayLackColorAndTimesMayBeAnything) {
  const Shape shape{.color_rows = 24, .color_cols = 32};
  const auto calibration = calibration_of(shape);
  const fs::path path = folder_ / "gaps.mkv";
  const auto recorder = record_mkv(path, calibration);
  const std::int64_t times[] = {std::numeric_limits<std::int64_t>::min(), -1, 0, 1, 400'000,
                                std::numeric_limits<std::int64_t>::max()};
  std::int64_t number = std::numeric_limits<std::int64_t>::min();
  for (const std::int64_t time : times) {
    RgbdFrame frame = frame_of(shape, 3, calibration);
    frame.time_ns = time;
    frame.number = number++;
    if (time == 0) frame.color.clear();
    if (time == 1) frame.body_index.clear();
    recorder->write(frame);
  }
  recorder->close();
  const auto source = open_mkv(path);
  RgbdFrame frame;
  for (const std::int64_t time : times) {
    ASSERT_EQ(source->read(frame, 0ms), ReadStatus::kFrame);
    EXPECT_EQ(frame.time_ns, time);
    EXPECT_EQ(frame.color.empty(), time == 0);
    EXPECT_EQ(frame.body_index.empty(), time == 1);
  }
  EXPECT_EQ(source->read(frame, 0ms), ReadStatus::kEnd);
  EXPECT_EQ(counted(*source)["lost"], 0);
}

TEST_F(Mkv, RefusesFramesOutOfOrderAndPathsInUse) {
  const Shape shape;
  const auto calibration = calibration_of(shape);
  const fs::path path = folder_ / "order.mkv";
  const auto recorder = record_mkv(path, calibration);
  recorder->write(frame_of(shape, 5, calibration));
  EXPECT_THROW(recorder->write(frame_of(shape, 5, calibration)), InputError);
  EXPECT_THROW(recorder->write(frame_of(shape, 4, calibration)), InputError);
  EXPECT_THROW(recorder->write(frame_of({.rows = 12}, 6, calibration)), InputError);
  EXPECT_THROW(recorder->write({}), InputError);
  const Shape flat{.rows = 3};  // FFmpeg's FFV1 would store zeros for so few rows
  EXPECT_THROW(record_mkv(folder_ / "flat.mkv", calibration_of(flat)), InputError);
  recorder->write(frame_of(shape, 6, calibration));
  recorder->close();
  EXPECT_THROW(recorder->write(frame_of(shape, 7, calibration)), InputError);
  EXPECT_EQ(replay(*open_mkv(path), shape), (std::vector<std::int64_t>{5, 6}));

  EXPECT_THROW(record_mkv(path, calibration), InputError);
  write_bytes(folder_ / "notes.mkv", "notes", 5);
  EXPECT_THROW(record_mkv(folder_ / "notes.mkv", calibration, {.overwrite = true}), InputError);
  EXPECT_THROW(record_mkv(folder_ / "no" / "x.mkv", calibration), fs::filesystem_error);
  record(path, shape, 3, {.overwrite = true});
  EXPECT_EQ(replay(*open_mkv(path), shape).size(), 3U);
}

TEST_F(Mkv, TheSameFramesGiveTheSameFile) {
  const Shape shape{.color_rows = 24, .color_cols = 32};
  record(folder_ / "a.mkv", shape, 4);
  record(folder_ / "b.mkv", shape, 4);
  EXPECT_EQ(bytes_of_file(folder_ / "a.mkv"), bytes_of_file(folder_ / "b.mkv"));
}

/// Records `count` frames; returns the sizes of the file after the header and after each frame.
std::vector<std::uintmax_t> record_with_sizes(const fs::path& path, const Shape& shape,
                                              std::int64_t count, bool close) {
  const auto calibration = calibration_of(shape);
  const auto recorder = record_mkv(path, calibration);
  std::vector<std::uintmax_t> sizes;
  for (std::int64_t n = 0; n < count; ++n) {
    recorder->write(frame_of(shape, n, calibration));
    sizes.push_back(fs::file_size(path));  // all bytes are handed to the operating system
  }
  if (close) recorder->close();
  return sizes;
}

TEST_F(Mkv, CutFilesGiveAllWholeFrames) {
  const Shape shape{.rows = 12, .cols = 16, .color_rows = 12, .color_cols = 16};
  for (const bool closed : {true, false}) {
    const fs::path whole = folder_ / "whole.mkv", cut = folder_ / "cut.mkv";
    fs::remove(whole);
    const auto sizes = record_with_sizes(whole, shape, 8, closed);
    fs::remove(cut);
    fs::copy_file(whole, cut);
    int refused = 0;
    for (std::uintmax_t length = fs::file_size(whole); length-- > 0;) {
      // All boundaries, and a sample that is dense in the header and the first frame.
      const bool at_boundary = std::find_if(sizes.begin(), sizes.end(), [&](auto size) {
                                 return length + 1 >= size && length <= size + 1;
                               }) != sizes.end();
      if (!at_boundary && length % ((length < sizes[0] ? 3 : 37) * kThinning) != 0) continue;
      fs::resize_file(cut, length);
      const bool at_end_of_frame = std::find(sizes.begin(), sizes.end(), length) != sizes.end();
      std::vector<std::int64_t> expected;
      for (std::size_t n = 0; n < sizes.size(); ++n) {
        if (sizes[n] <= length) expected.push_back(static_cast<std::int64_t>(n));
      }
      try {
        const auto source = open_mkv(cut);
        EXPECT_EQ(replay(*source, shape), expected) << length;
        auto counters = counted(*source);
        EXPECT_EQ(counters["lost"] + counters["damaged"], 0) << length;
        // A finished file states its end; an unfinished one shows only that it was not finished.
        const bool is_missed = expected.size() < sizes.size();
        const bool is_countable = closed && !is_missed;  // if the index is there
        EXPECT_EQ(source->num_frames().value_or(8), 8) << length;
        EXPECT_LE(source->num_frames().has_value(), is_countable) << length;
        EXPECT_EQ(counters["unfinished"], closed ? 0 : 1) << length;
        if (closed) {
          EXPECT_EQ(counters["cut_short"], is_missed ? 1 : 0) << length;
        } else if (at_end_of_frame) {
          EXPECT_EQ(counters["cut_short"], 0) << length;
        }
      } catch (const FormatError&) {
        ++refused;
        EXPECT_TRUE(expected.empty()) << length;
      }
    }
    EXPECT_GT(refused, 100 / static_cast<int>(kThinning));
  }
}

TEST_F(Mkv, FlippedBitsAreCountedAndNeverShown) {
  const Shape shape{.rows = 12, .cols = 16, .color_rows = 12, .color_cols = 16};
  constexpr std::int64_t kFrames = 6;
  constexpr std::uint64_t kTrials = 1200 / kThinning;
  const auto calibration = calibration_of(shape);
  const fs::path path = folder_ / "flipped.mkv";
  record(path, shape, kFrames);
  const auto size = static_cast<std::uint64_t>(fs::file_size(path));
  std::fstream file(path, std::ios::binary | std::ios::in | std::ios::out);
  const auto flip = [&](std::size_t byte, int bit) {
    file.seekg(static_cast<std::streamoff>(byte));
    const int flipped = file.get() ^ bit;
    file.seekp(static_cast<std::streamoff>(byte));
    file.put(static_cast<char>(flipped)).flush();
  };
  int unreadable = 0, noticed = 0, harmless = 0;
  for (std::uint64_t trial = 0; trial < kTrials; ++trial) {
    const std::size_t byte = random_bits(1, trial) % size;
    const int bit = 1 << (random_bits(2, trial) % 8);
    flip(byte, bit);
    SCOPED_TRACE("byte " + std::to_string(byte) + " bit " + std::to_string(bit));
    try {
      const auto source = open_mkv(path);
      expect_same_calibration(*source->calibration(), *calibration);
      RgbdFrame frame;
      std::int64_t before = -1;
      while (source->read(frame, 0ms) == ReadStatus::kFrame) {
        const RgbdFrame expected = frame_of(shape, frame.number, {});
        expect_same_but_color(frame, expected);
        EXPECT_TRUE(frame.color == through_jpeg(expected, 90));
        EXPECT_GT(frame.number, before);
        before = frame.number;
      }
      auto counters = counted(*source);
      const std::int64_t missing = kFrames - counters["frames"];
      const std::int64_t known = counters["damaged"] + counters["lost"];
      EXPECT_TRUE(known == missing || (counters["cut_short"] == 1 && known < missing));
      missing > 0 ? ++noticed : ++harmless;
    } catch (const FormatError&) {
      ++unreadable;
    }
    flip(byte, bit);
    if (HasFailure()) break;
  }
  RecordProperty("unreadable", unreadable);
  RecordProperty("noticed", noticed);
  RecordProperty("harmless", harmless);
  EXPECT_GT(noticed, static_cast<int>(kTrials / 2));
}

TEST_F(Mkv, AKilledRecorderLosesNoFrameThatItAcknowledged) {
  const Shape shape{.rows = 96, .cols = 128, .color_rows = 96, .color_cols = 128};
  std::vector<std::size_t> kept;
  for (int trial = 0; trial < 8; ++trial) {
    const fs::path path = folder_ / ("killed" + std::to_string(trial) + ".mkv");
    int ends[2];
    ASSERT_EQ(::pipe(ends), 0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      const auto calibration = calibration_of(shape);
      const auto recorder = record_mkv(path, calibration);
      for (std::int64_t n = 0; n < 300; ++n) {
        recorder->write(frame_of(shape, n, calibration));
        if (::write(ends[1], "x", 1) != 1) ::_exit(1);
      }
      ::pause();
    }
    ::close(ends[1]);
    char acknowledged = 0;
    for (int n = 0; n < 10 * trial; ++n) ASSERT_EQ(::read(ends[0], &acknowledged, 1), 1);
    std::this_thread::sleep_for(std::chrono::microseconds(random_bits(3, trial) % 5000));
    ::kill(child, SIGKILL);
    ASSERT_EQ(::waitpid(child, nullptr, 0), child);
    std::size_t written = static_cast<std::size_t>(10 * trial);
    while (::read(ends[0], &acknowledged, 1) == 1) ++written;
    ::close(ends[0]);
    if (written == 0) continue;  // killed before the first frame
    const auto source = open_mkv(path);
    const auto numbers = replay(*source, shape);
    EXPECT_GE(numbers.size(), written);
    EXPECT_LE(numbers.size(), written + 1);
    for (std::size_t n = 0; n < numbers.size(); ++n) {
      EXPECT_EQ(numbers[n], static_cast<std::int64_t>(n));
    }
    auto counters = counted(*source);
    EXPECT_EQ(counters["unfinished"], 1);
    EXPECT_EQ(counters["damaged"] + counters["lost"], 0);
  }
}

TEST_F(Mkv, AFullDiskIsAnErrorAndLeavesWholeFrames) {
  const Shape shape{.rows = 96, .cols = 128, .color_rows = 96, .color_cols = 128};
  const auto calibration = calibration_of(shape);
  const auto ignored = std::signal(SIGXFSZ, SIG_IGN);
  ::rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  for (const rlim_t limit : {rlim_t{100}, rlim_t{50'000}, rlim_t{200'001}}) {
    SCOPED_TRACE(limit);
    const fs::path path = folder_ / ("full" + std::to_string(limit) + ".mkv");
    const auto recorder = record_mkv(path, calibration);
    const ::rlimit full{limit, before.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &full);
    std::vector<std::int64_t> written;
    std::error_code reason;
    try {
      for (std::int64_t n = 0; n < 300; ++n) {
        recorder->write(frame_of(shape, n, calibration));
        written.push_back(n);
      }
    } catch (const fs::filesystem_error& error) {
      reason = error.code();
      EXPECT_EQ(error.path1(), path);
    }
    EXPECT_EQ(reason, std::errc::file_too_large);
    EXPECT_THROW(recorder->write(frame_of(shape, 300, calibration)), fs::filesystem_error);
    EXPECT_THROW(recorder->close(), fs::filesystem_error);
    recorder->close();
    ::setrlimit(RLIMIT_FSIZE, &before);
    EXPECT_LE(fs::file_size(path), limit);
    if (limit < 1000) {
      EXPECT_THROW(open_mkv(path), FormatError);
    } else {
      EXPECT_EQ(replay(*open_mkv(path), shape), written);
      EXPECT_GT(written.size(), 0U);
    }
  }
  std::signal(SIGXFSZ, ignored);
}

TEST_F(Mkv, ImagesOfManySlicesAreRefusedBeforeTheyTakeMemory) {
  const ImageSize size{48, 64};
  const fs::path path = folder_ / "slices.mkv";
  std::vector<std::uint16_t> pixels(48 * 64);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::uint16_t>(i * 31);
  {
    MatroskaWriter writer(path, false);
    const int track = writer.add({.kind = MkvKind::kVideo,
                                  .format = MkvFormat::kFfv1,
                                  .pixels = MkvPixels::kGray16,
                                  .width = 64,
                                  .height = 48});
    writer.start();
    writer.write(track, writer.encode(track, pixels.data()), 0);
    writer.finish();
  }
  MatroskaReader reader(path);
  EXPECT_EQ(ffv1_version(from_mkv(reader.track(0).data)), 3);
  EXPECT_EQ(ffv1_version({}), 0);
  reader.open_decoder(0, MkvPixels::kGray16, size);
  MatroskaPacket packet;
  ASSERT_TRUE(reader.next(packet));
  const std::vector<std::uint16_t> expected = pixels;
  std::fill(pixels.begin(), pixels.end(), std::uint16_t{0});
  reader.decode(0, packet.bytes, pixels.data());
  EXPECT_EQ(pixels, expected);

  const std::vector<std::byte> empty_slices(8 * 66);
  try {
    reader.decode(0, empty_slices, pixels.data());
    FAIL();
  } catch (const FormatError& error) {
    EXPECT_NE(error.reason().find("at most 64 slices"), std::string::npos);
  }
}

std::ptrdiff_t open_descriptors() {
  return std::distance(fs::directory_iterator("/proc/self/fd"), fs::directory_iterator());
}

/// The library of this test with one defect.
template <auto Spoil>
FoundMkvCodec spoiled() {
  static const MkvCodec codec = [] {
    MkvCodec copy = ffmpeg_mkv_codec();
    Spoil(copy);
    return copy;
  }();
  return {&codec, "", ""};
}

void expect_refused(MkvLoader loader, const fs::path& path, const std::string& reason) {
  const std::vector<char> before = bytes_of_file(path);
  const std::ptrdiff_t descriptors = open_descriptors();
  set_mkv_loader(loader);
  for (int trial = 0; trial < 3; ++trial) {
    try {
      record_mkv(path, calibration_of({}), {.overwrite = true});
      ADD_FAILURE() << reason;
    } catch (const DeviceError& error) {
      EXPECT_NE(std::string(error.what()).find(reason), std::string::npos) << error.what();
    }
  }
  EXPECT_EQ(open_descriptors(), descriptors);
  EXPECT_EQ(bytes_of_file(path), before);
}

TEST_F(Mkv, ALibraryThatDoesNotFitIsRefusedBeforeAnythingIsTouched) {
  const fs::path path = folder_ / "old.mkv";
  record(path, {}, 3);
  expect_refused(spoiled<[](MkvCodec& codec) { ++codec.version; }>, path,
                 "the codec library has interface 3, expected 2 (install all of manip3d again)");
  expect_refused(spoiled<[](MkvCodec& codec) { codec.size -= 8; }>, path, "the codec library has");
  expect_refused(
      spoiled<[](MkvCodec& codec) { codec.missing = [] { return "the muxer of Matroska"; }; }>,
      path, "FFmpeg was built without the muxer of Matroska");
  expect_refused(spoiled<[](MkvCodec& codec) {
                   codec.open_writer = [](const MkvFile*, MkvWriter**) { return -EINVAL; };
                 }>,
                 path, "old.mkv: cannot write: Invalid argument");
  expect_refused([] { return FoundMkvCodec{nullptr, "it is on the moon", "fly there"}; }, path,
                 "mkv: it is on the moon (fly there)");
  EXPECT_THROW(open_mkv(path), DeviceError);
}

TEST_F(Mkv, ARecordingStaysUntilTheFirstFrameOfTheNext) {
  const fs::path path = folder_ / "old.mkv";
  record(path, {}, 3);
  const auto calibration = calibration_of({});
  record_mkv(path, calibration, {.overwrite = true});  // killed before its first frame
  EXPECT_EQ(replay(*open_mkv(path), {}).size(), 3U);
  const auto recorder = record_mkv(path, calibration, {.overwrite = true});
  EXPECT_THROW(record_mkv(path, calibration, {.overwrite = true}), InputError);
  recorder->write(frame_of({}, 7, calibration));
  EXPECT_EQ(replay(*open_mkv(path), {}), (std::vector<std::int64_t>{7}));
}

TEST(Sha256, IsTheOneOfTheStandard) {  // FIPS 180-4's examples
  const std::string text = "abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq";
  EXPECT_EQ(sha256({}), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256(std::as_bytes(std::span(text))),
            "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
}

TEST_F(Mkv, RefusesWhatIsNoRecording) {
  EXPECT_THROW(open_mkv(folder_ / "absent.mkv"), fs::filesystem_error);
  EXPECT_THROW(open_mkv(folder_), fs::filesystem_error);
  ASSERT_EQ(::mkfifo((folder_ / "pipe.mkv").c_str(), 0600), 0);
  EXPECT_THROW(open_mkv(folder_ / "pipe.mkv"), FormatError);  // opening does not wait for a writer
  EXPECT_THROW(record_mkv(folder_ / "pipe.mkv", calibration_of({}), {.overwrite = true}),
               InputError);
  EXPECT_THROW(open_mkv("/dev/zero"), FormatError);
  const fs::path path = folder_ / "text.mkv";
  write_bytes(path, "", 0);
  EXPECT_THROW(open_mkv(path), FormatError);
  write_bytes(path, "a text, and not a short one at that", 35);
  try {
    open_mkv(path);
    FAIL();
  } catch (const FormatError& error) {
    EXPECT_EQ(error.file(), path.string());
  }
}

}  // namespace
}  // namespace manip3d
