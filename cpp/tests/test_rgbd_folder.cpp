#include <gtest/gtest.h>
#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/lsan_interface.h>
#endif

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <utility>

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

/// The largest number of pairs and the least sum of differences, by trying all pairings.
std::pair<std::int64_t, std::int64_t> best_by_trial(const std::vector<TimedFile>& files,
                                                    const std::vector<TimedFile>& others,
                                                    std::int64_t most_ns, std::size_t file = 0,
                                                    std::uint32_t taken = 0) {
  if (file == files.size()) return {0, 0};
  auto best = best_by_trial(files, others, most_ns, file + 1, taken);  // without a partner
  for (std::size_t k = 0; k < others.size(); ++k) {
    const std::int64_t apart = std::abs(others[k].time_ns - files[file].time_ns);
    if (apart > most_ns || (taken >> k & 1U) != 0) continue;
    auto found = best_by_trial(files, others, most_ns, file + 1, taken | 1U << k);
    found = {found.first + 1, found.second + apart};
    if (found.first > best.first || (found.first == best.first && found.second < best.second)) {
      best = found;
    }
  }
  return best;
}

TEST(Associate, MostPairsThenLeastDifferencesAsByTrial) {
  std::uint32_t state = 1;
  const auto random = [&](std::uint32_t n) {
    state = state * 1664525U + 1013904223U;
    return static_cast<std::int64_t>((state >> 8) % n);
  };
  for (int trial = 0; trial < 400; ++trial) {
    std::vector<TimedFile> files(static_cast<std::size_t>(random(7)));
    std::vector<TimedFile> others(static_cast<std::size_t>(random(7)));
    for (auto* list : {&files, &others}) {
      for (TimedFile& file : *list) file.time_ns = random(40);
      std::ranges::sort(*list, {}, &TimedFile::time_ns);
    }
    const auto found = associate(files, others, 7);
    std::vector<bool> is_taken(others.size());
    std::pair<std::int64_t, std::int64_t> total{0, 0};
    for (std::size_t i = 0; i < files.size(); ++i) {
      if (found[i] < 0) continue;
      ASSERT_FALSE(is_taken[found[i]]);
      is_taken[found[i]] = true;
      const std::int64_t apart = std::abs(others[found[i]].time_ns - files[i].time_ns);
      ASSERT_LE(apart, 7);
      total = {total.first + 1, total.second + apart};
    }
    ASSERT_EQ(total, best_by_trial(files, others, 7)) << trial;
  }
}

TEST(Associate, EqualTimesArePairedInLittleTime) {
  const std::vector<TimedFile> files(200'000), others(200'000);
  const auto partner = associate(files, others, 20'000'000);
  EXPECT_GE(std::ranges::count_if(partner, [](std::int64_t k) { return k >= 0; }), 8);
}

TEST(Associate, NoColorImageIsUsedTwice) {
  std::vector<TimedFile> depth(60), color(30);  // 60 and 30 images a second
  for (std::int64_t i = 0; i < 60; ++i) depth[i].time_ns = i * 1'000'000'000 / 60;
  for (std::int64_t i = 0; i < 30; ++i) color[i].time_ns = i * 1'000'000'000 / 30 + 1'000'000;
  const auto partner = associate(depth, color, 20'000'000);
  for (std::int64_t i = 0; i < 60; ++i) EXPECT_EQ(partner[i], i % 2 == 0 ? i / 2 : -1) << i;
}

TEST(Associate, TimesAtTheEndsOfTheirRangeAreFarApart) {
  const TimedFile first{-9'000'000'000'000'000'000, "a"}, last{9'000'000'000'000'000'000, "b"};
  EXPECT_EQ(associate({first}, {last}, 20'000'000), std::vector<std::int64_t>{-1});
  EXPECT_EQ(associate({first, last}, {last}, 20'000'000), (std::vector<std::int64_t>{-1, 0}));
}

TEST(TumList, ALastLineThatIsTornIsLeftOut) {
  const std::string whole = "# time file\n1.0 rgb/1.0.png\n1.1 rgb/1.1.png\n";
  const auto exists = [](const std::string& name) { return name.ends_with(".png"); };
  const auto parsed = [&](std::size_t size) {
    return parse_tum_list(std::string_view(whole).substr(0, size), exists);
  };
  EXPECT_EQ(parsed(whole.size()).files.size(), 2U);
  EXPECT_FALSE(parsed(whole.size()).is_torn);
  EXPECT_EQ(parsed(whole.size() - 1).files.size(), 2U);  // as many editors end a file
  EXPECT_FALSE(parsed(whole.size() - 1).is_torn);
  const std::size_t second = whole.rfind("1.1 ");
  for (std::size_t size = second + 1; size + 1 < whole.size(); ++size) {
    EXPECT_EQ(parsed(size).files.size(), 1U) << size;
    EXPECT_TRUE(parsed(size).is_torn) << size;
  }
  for (std::size_t size = 0; size <= second; ++size) parsed(size);
  EXPECT_THROW(parse_tum_list("1.0\n1.1 rgb/1.1.png\n", exists), FormatError);
}

TEST(TumList, CommasAndAByteOrderMarkAreBlanks) {
  const auto exists = [](const std::string&) { return true; };
  const auto check = [&](const std::string& text) {
    const auto files = parse_tum_list(text, exists).files;
    ASSERT_EQ(files.size(), 1U) << text;
    EXPECT_EQ(files[0].time_ns, 1'305'031'102'160'407'000) << text;
    EXPECT_EQ(files[0].name, "depth/a.png") << text;
  };
  check("1305031102.160407,depth/a.png\n");
  check("1305031102.160407, depth/a.png\r\n");
  check("1305031102.160407\t,depth/a.png,more\n");
  check(",1305031102.160407 depth/a.png\n");
  check("# a, comment\n1305031102.160407,depth/a.png # another, one\n");
  check("\xEF\xBB\xBF# time file\n1305031102.160407 depth/a.png\n");
  check(
      "\xEF\xBB\xBF"
      "1305031102.160407 depth/a.png\n");
  const auto with_decimal_comma = parse_tum_list("12,25 a.png\n-1,5 b.png\n", exists).files;
  ASSERT_EQ(with_decimal_comma.size(), 2U);
  EXPECT_EQ(with_decimal_comma[0].time_ns, -1'500'000'000);
  EXPECT_EQ(with_decimal_comma[1].time_ns, 12'250'000'000);
  const auto exact = parse_tum_list("-1700000000.123456789 a.png\n+0.000000005 b.png\n", exists);
  EXPECT_EQ(exact.files.at(0).time_ns, -1'700'000'000'123'456'789);
  EXPECT_EQ(exact.files.at(1).time_ns, 5);
  EXPECT_EQ(parse_tum_list("12,a.png\n", exists).files.at(0).time_ns, 12'000'000'000);
  EXPECT_THROW(parse_tum_list("1.0,\n", exists), FormatError);
  EXPECT_EQ(parse_tum_list("1.0 depth/a,1.png\n", exists).files.at(0).name, "depth/a,1.png");
  EXPECT_EQ(parse_tum_list("1,5 depth/a,1.png\n", exists).files.at(0).name, "depth/a,1.png");
  EXPECT_EQ(parse_tum_list("12,25\n", exists).files.at(0).name, "25");
  for (const char* text : {"#\n1,05,a.png\n", "#\n1,05, a.png\n", "#\n1,05 ,a.png\n"}) {
    try {
      parse_tum_list(text, exists);
      FAIL() << text;
    } catch (const FormatError& error) {
      EXPECT_EQ(error.reason(), "time: expected a decimal point, or blanks behind the time");
      EXPECT_EQ(error.position().line, 2) << text;
    }
  }
  EXPECT_THROW(parse_tum_list("1.0,/a.png\n", exists), FormatError);
  EXPECT_THROW(parse_tum_list("1.0 a.png\n\xEF\xBB\xBF"
                              "1.1 b.png\n",
                              exists),
               FormatError);
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
