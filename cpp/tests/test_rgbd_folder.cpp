#include <gtest/gtest.h>
#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/lsan_interface.h>
#endif

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>

#include "capture/image_codec.hpp"
#include "capture/image_frames.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

std::shared_ptr<RgbdCalibration> small_camera() {
  auto calibration = std::make_shared<RgbdCalibration>();
  calibration->depth.width = 5;
  calibration->depth.height = 3;
  calibration->depth.fx = 4.0 / 3.0;
  calibration->depth.fy = 0.1;
  calibration->depth.cx = 1.5;
  return calibration;
}

TEST(RgbdJson, CalibrationsAndSkeletonsAreExact) {
  auto calibration = small_camera();
  calibration->ray_table = {NAN, -0.0F, 1e-45F, 3.4e38F, 0.1F};
  calibration->ray_table.resize(30, 1.0F / 3.0F);
  calibration->depth.ray_table = calibration->ray_table.data();
  Registration& registration = calibration->registration.emplace();
  registration.color = small_camera()->depth;
  registration.color.distortion = {0.1, -0.2, 1e-300, 4.0, 5.0};
  registration.translation = {0.1, 0.2, 1.0 / 3.0};
  const auto json = JsonPlace::Json::parse(calibration_to_json(*calibration).dump());
  const auto read = calibration_from_json(JsonPlace(json, "", 0));
  EXPECT_EQ(read->depth.fx, calibration->depth.fx);
  EXPECT_EQ(read->registration->color.distortion, registration.color.distortion);
  EXPECT_EQ(read->registration->translation, registration.translation);
  ASSERT_EQ(read->depth.ray_table, read->ray_table.data());
  ASSERT_EQ(read->ray_table.size(), 30U);
  EXPECT_EQ(std::memcmp(read->ray_table.data(), calibration->ray_table.data(), 120), 0);

  Skeleton skeleton;
  skeleton.id = std::numeric_limits<std::int64_t>::min();
  skeleton.positions[3] = {0.1F, -INFINITY, NAN};
  skeleton.orientations[24] = {1e-45F, INFINITY, -0.0F, 1.0F / 3.0F};
  skeleton.states[24] = TrackingState::kTracked;
  const auto list = JsonPlace::Json::parse(skeletons_to_json({skeleton}).dump());
  std::vector<Skeleton> skeletons;
  skeletons_from_json(JsonPlace(list, "", 0), skeletons);
  ASSERT_EQ(skeletons.size(), 1U);
  EXPECT_EQ(skeletons[0].id, skeleton.id);
  EXPECT_EQ(skeletons[0].states, skeleton.states);
  EXPECT_TRUE(std::isnan(skeletons[0].positions[3].z()));
  EXPECT_EQ(skeletons[0].positions[3].y(), -INFINITY);
  EXPECT_EQ(skeletons[0].orientations, skeleton.orientations);
  EXPECT_TRUE(std::signbit(skeletons[0].orientations[24][2]));
}

TEST(ImageCodec, PngRoundTripsAndKindsAreKept) {
  const std::vector<std::uint16_t> depth = {0, 1, 255, 256, 4000, 65535};
  const auto png = encode_png(depth, 3);
  EXPECT_EQ(decode_depth(png, 6).pixels, depth);
  EXPECT_EQ(decode_depth(png, 6).rows, 2);
  EXPECT_THROW(decode_depth(png, 5), FormatError);
  EXPECT_THROW(decode_grey(png, 6), FormatError);
  const std::vector<std::uint8_t> grey = {0, 1, 2, 3, 254, 255};
  const auto small = encode_png(grey, 2, 1);
  EXPECT_EQ(decode_grey(small, 6).pixels, grey);
  EXPECT_EQ(decode_depth(small, 6).pixels, (std::vector<std::uint16_t>{0, 1, 2, 3, 254, 255}));
  const std::vector<std::uint8_t> rgb = {1, 2, 3, 4, 5, 6};
  const auto color = encode_png(rgb, 2, 3);
  EXPECT_EQ(decode_rgb(color, 2).pixels, rgb);
  EXPECT_THROW(decode_depth(color, 2), FormatError);
  EXPECT_EQ(decode_rgb(small, 6).pixels.size(), 18U);  // a grey image becomes R, G, B
}

TEST(ImageCodec, NoPrefixOfAPngIsAnImage) {
  const std::vector<std::uint16_t> depth(200, 1234);
  const auto png = encode_png(depth, 20);
  for (std::size_t size = 0; size < png.size(); ++size) {
    EXPECT_THROW(decode_depth(std::span(png).first(size), 1000), FormatError) << size;
  }
}

TEST(Unmirror, ColumnsAndPrincipalPointsTurnTogether) {
  auto stored = small_camera();
  stored->depth.mirrored = true;
  const auto turned = unmirrored(stored);
  RgbdFrame frame;
  frame.rows = frame.color_rows = 1;
  frame.cols = frame.color_cols = 5;
  frame.depth = {1, 2, 3, 4, 5};
  frame.color = {1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 6};
  unmirror_images(*stored, frame);
  EXPECT_EQ(frame.depth, (std::vector<std::uint16_t>{5, 4, 3, 2, 1}));
  EXPECT_EQ(frame.color[2], 6);  // R, G, B keep their order
  EXPECT_FALSE(turned->depth.mirrored);
  // The same point is seen in the mirrored pixel.
  const Eigen::Vector3d point(0.3, 0.1, 1.0);
  EXPECT_NEAR(project(turned->depth, point).x(), 4.0 - project(stored->depth, point).x(), 1e-12);
  EXPECT_EQ(unmirrored(turned), turned);
}

TEST(Unmirror, ARayTableShowsWhichWayItRuns) {
  auto stored = small_camera();
  for (int i = 0; i < 15; ++i) {
    stored->ray_table.push_back(static_cast<float>(2 - i % 5));
    stored->ray_table.push_back(static_cast<float>(i / 5));
  }
  stored->depth.ray_table = stored->ray_table.data();
  const auto turned = unmirrored(stored);
  ASSERT_NE(turned, stored);
  EXPECT_EQ(turned->depth.ray_table, turned->ray_table.data());
  EXPECT_EQ(turned->ray_table[0], -2.0F);
  EXPECT_EQ(turned->ray_table[8], 2.0F);
  EXPECT_EQ(turned->ray_table[11], 1.0F);
  RgbdFrame frame;
  frame.cols = 5;
  frame.depth = {1, 2, 3, 4, 5};
  unmirror_images(*stored, frame);
  EXPECT_EQ(frame.depth[0], 5);
}

TEST(Associate, NearestWithinReachAsByBruteForce) {
  std::uint32_t state = 1;
  const auto random = [&](std::uint32_t n) {
    state = state * 1664525U + 1013904223U;
    return static_cast<std::int64_t>((state >> 8) % n);
  };
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<TimedFile> files(8), others(static_cast<std::size_t>(random(9)));
    for (auto* list : {&files, &others}) {
      for (TimedFile& file : *list) file.time_ns = random(60);
      std::ranges::sort(*list, {}, &TimedFile::time_ns);
    }
    const auto nearest = associate(files, others, 7);
    for (std::size_t i = 0; i < files.size(); ++i) {
      std::int64_t best = 8;
      for (const TimedFile& other : others) {
        best = std::min(best, std::abs(other.time_ns - files[i].time_ns));
      }
      const std::int64_t found = nearest[i];
      ASSERT_EQ(found < 0, best > 7);
      if (found < 0) continue;
      EXPECT_EQ(std::abs(others[found].time_ns - files[i].time_ns), best);
    }
  }
}

TEST(Registry, TellsSchemesAndRefusesOthers) {
#ifdef __SANITIZE_ADDRESS__
  const __lsan::ScopedDisabler drivers;  // OpenNI2's drivers leak when they are unloaded
#endif
  EXPECT_THROW(open_rgbd("nothing:here"), InputError);
  EXPECT_THROW(open_rgbd("folder"), InputError);
  RgbdOptions options;
  options.speed = NAN;
  EXPECT_THROW(open_rgbd("folder:x", options), InputError);
  for (const RgbdScheme& scheme : rgbd_schemes()) {
    EXPECT_TRUE(scheme.open || !scheme.reason.empty()) << scheme.name;
    EXPECT_EQ(scheme.reason.empty(), scheme.cure.empty()) << scheme.name;
  }
}

}  // namespace
}  // namespace manip3d
