#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>

#include "allocations.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/shoe_cover.hpp"

namespace manip3d {
namespace {

TEST(Hsv, KnownColorsAreOpenCvs) {
  struct Case {
    std::uint8_t r, g, b;
    int h, s, v;
  };
  for (const Case& c : {Case{255, 0, 0, 0, 255, 255},
                        {0, 255, 0, 60, 255, 255},
                        {0, 0, 255, 120, 255, 255},
                        {255, 255, 255, 0, 0, 255},
                        {0, 0, 0, 0, 0, 0},
                        {12, 34, 56, 105, 200, 56},
                        {56, 34, 12, 15, 200, 56},
                        {200, 10, 100, 166, 242, 200},
                        {30, 60, 200, 115, 217, 200},
                        {70, 90, 180, 115, 156, 180},
                        {130, 100, 255, 126, 155, 255}}) {
    const Hsv hsv = to_hsv(c.r, c.g, c.b);
    EXPECT_EQ(hsv.hue, c.h);
    EXPECT_EQ(hsv.saturation, c.s);
    EXPECT_EQ(hsv.value, c.v);
  }
}

TEST(Hsv, AllColorsAreOpenCvs) {
  // FNV-1a of cv::cvtColor's output (OpenCV 4.11, COLOR_RGB2HSV) over red, green, blue.
  std::uint64_t hash = 0xcbf29ce484222325U;
  const auto add = [&](int byte) {
    hash = (hash ^ static_cast<std::uint64_t>(byte)) * 0x100000001b3U;
  };
  for (int r = 0; r < 256; ++r) {
    for (int g = 0; g < 256; ++g) {
      for (int b = 0; b < 256; ++b) {
        const Hsv hsv = to_hsv(static_cast<std::uint8_t>(r), static_cast<std::uint8_t>(g),
                               static_cast<std::uint8_t>(b));
        add(hsv.hue), add(hsv.saturation), add(hsv.value);
      }
    }
  }
  EXPECT_EQ(hash, 0xd22f261eba9e21a0U);
}

constexpr std::int64_t kRows = 60, kCols = 80;
constexpr std::size_t kFoot = 15;

/// A grey wall 2 m away; the colour image has the pixels of the depth image.
RgbdFrame wall() {
  auto calibration = std::make_shared<RgbdCalibration>();
  calibration->depth = {
      .width = kCols, .height = kRows, .fx = 70, .fy = 70, .cx = 39.5, .cy = 29.5};
  RgbdFrame frame;
  frame.rows = frame.color_rows = kRows;
  frame.cols = frame.color_cols = kCols;
  frame.depth.assign(kRows * kCols, 2000);
  frame.color.assign(3 * kRows * kCols, 128);
  frame.calibration = calibration;
  return frame;
}

void paint(RgbdFrame& frame, int v0, int u0, int height, int width, bool blue = true) {
  for (int v = v0; v < v0 + height; ++v) {
    for (int u = u0; u < u0 + width; ++u) {
      std::uint8_t* rgb = frame.color.data() + 3 * (v * frame.color_cols + u);
      rgb[0] = 30, rgb[1] = 60, rgb[2] = blue ? 200 : 60;
    }
  }
}

const Eigen::Vector3f kAnkle(0, 0, 2.0F);

class ShoeCover : public ::testing::Test {
 protected:
  RgbdFrame frame_ = wall();
  PixelRays rays_{frame_.calibration->depth};
  ShoeCoverTracker tracker_;
};

TEST_F(ShoeCover, TheFootIsTheMedianOfTheBluePatch) {
  paint(frame_, 30, 40, 7, 9);           // rows 30 to 36, columns 40 to 48
  frame_.depth[33 * kCols + 44] = 1700;  // one outlier changes a mean, but not the median
  const auto foot = tracker_.find(frame_, rays_, kAnkle);
  ASSERT_TRUE(foot);
  EXPECT_EQ(tracker_.num_pixels(), 63);
  EXPECT_NEAR(foot->x(), (44 - 39.5) / 70 * 2, 0.02);
  EXPECT_NEAR(foot->y(), (33 - 29.5) / 70 * 2, 0.02);
  EXPECT_FLOAT_EQ(foot->z(), 2.0F);
}

TEST_F(ShoeCover, TheLargestPatchWithinReachCounts) {
  paint(frame_, 28, 38, 7, 7);  // 49 pixels
  paint(frame_, 21, 32, 5, 9);  // 45 pixels
  paint(frame_, 50, 10, 8, 8);  // 64 pixels, 1 m away
  ASSERT_TRUE(tracker_.find(frame_, rays_, kAnkle));
  EXPECT_EQ(tracker_.num_pixels(), 49);
  paint(frame_, 28, 38, 7, 1, false);  // 42 pixels are left
  ASSERT_TRUE(tracker_.find(frame_, rays_, kAnkle));
  EXPECT_EQ(tracker_.num_pixels(), 45);
  paint(frame_, 26, 37, 2, 2);  // touches both at corners: one patch
  ASSERT_TRUE(tracker_.find(frame_, rays_, kAnkle));
  EXPECT_EQ(tracker_.num_pixels(), 45 + 42 + 4);
}

TEST_F(ShoeCover, TooFewPixelsOrNoDepthAreNoFoot) {
  paint(frame_, 30, 34, 3, 13);
  EXPECT_FALSE(tracker_.find(frame_, rays_, kAnkle));
  EXPECT_EQ(tracker_.num_pixels(), 39);
  paint(frame_, 30, 40, 4, 10);
  EXPECT_TRUE(tracker_.find(frame_, rays_, kAnkle));
  frame_.depth.assign(kRows * kCols, 0);
  EXPECT_FALSE(tracker_.find(frame_, rays_, kAnkle));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(tracker_.find(wall(), rays_, {nan, nan, nan}));
}

TEST_F(ShoeCover, ColorIsLookedUpWhereItsCameraSeesThePoint) {
  auto calibration = std::make_shared<RgbdCalibration>(*frame_.calibration);
  Registration registration;
  registration.color = {.width = 160, .height = 120, .fx = 140, .fy = 140, .cx = 79.5, .cy = 59.5};
  registration.translation = {0.2, 0, 0};  // 14 pixels at 2 m
  calibration->registration = registration;
  frame_.calibration = calibration;
  frame_.color_rows = 120;
  frame_.color_cols = 160;
  frame_.color.assign(3 * 120 * 160, 128);
  paint(frame_, 52, 86, 16, 16);  // centred on the ankle, 14 pixels to the right
  const auto foot = tracker_.find(frame_, rays_, kAnkle);
  ASSERT_TRUE(foot);
  EXPECT_EQ(tracker_.num_pixels(), 64) << "a quarter of the colour camera's";
  EXPECT_NEAR(foot->x(), 0.0, 0.03);
}

TEST_F(ShoeCover, TheSkeletonsFootIsMoved) {
  paint(frame_, 30, 40, 7, 9);
  Skeleton skeleton;
  EXPECT_FALSE(tracker_.update(frame_, rays_, true, skeleton)) << "no ankle";
  skeleton.states[14] = TrackingState::kInferred;
  skeleton.positions[14] = kAnkle;
  ASSERT_TRUE(tracker_.update(frame_, rays_, true, skeleton));
  EXPECT_EQ(skeleton.states[kFoot], TrackingState::kTracked);
  EXPECT_FLOAT_EQ(skeleton.positions[kFoot].z(), 2.0F);
}

TEST_F(ShoeCover, FramesAllocateNothing) {
  if (!testing::kCountsAllocations) GTEST_SKIP() << "the sanitizer has operators of its own";
  paint(frame_, 30, 40, 7, 9);
  // Patches and seeds exchange their memory; after a few frames it is large enough.
  for (int i = 0; i < 10; ++i) (void)tracker_.find(frame_, rays_, kAnkle);
  const std::int64_t before = testing::num_allocations();
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(tracker_.find(frame_, rays_, kAnkle));
  EXPECT_EQ(testing::num_allocations(), before);
}

TEST_F(ShoeCover, WrongFramesAndOptionsAreRefused) {
  RgbdFrame grey = frame_;
  grey.color.clear();
  EXPECT_THROW((void)tracker_.find(grey, rays_, kAnkle), InputError);
  RgbdFrame small = frame_;
  small.rows = 10;
  EXPECT_THROW((void)tracker_.find(small, rays_, kAnkle), InputError);
  RgbdFrame wild = frame_;
  wild.calibration.reset();
  EXPECT_THROW((void)tracker_.find(wild, rays_, kAnkle), InputError);
  EXPECT_THROW(ShoeCoverTracker({.min_hue = 140}), InputError);
  EXPECT_THROW(ShoeCoverTracker({.min_saturation = 256}), InputError);
  EXPECT_THROW(ShoeCoverTracker({.reach = std::numeric_limits<double>::quiet_NaN()}), InputError);
  EXPECT_THROW(ShoeCoverTracker({.min_pixels = 0}), InputError);
}

}  // namespace
}  // namespace manip3d
