#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/simplify/depth_smoother.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kRows = 80, kCols = 60;

/// A slanted wall whose depths increase by `moved` metres, with at most 25 mm of noise.
std::vector<float> wall(float moved, std::uint32_t& state) {
  std::vector<float> depths(kRows * kCols);
  for (std::int64_t i = 0; i < kRows * kCols; ++i) {
    state = state * 1664525U + 1013904223U;
    const float noise = static_cast<float>(state >> 8U) / 16777216.0F - 0.5F;
    depths[i] = 2.0F + 0.004F * static_cast<float>(i % kCols) + moved + 0.05F * noise;
  }
  return depths;
}

DepthView view(const std::vector<float>& depths) {
  return {.rows = kRows, .cols = kCols, .metres = depths.data()};
}

double mean_error(const std::vector<float>& depths, float moved) {
  double sum = 0.0;
  for (std::int64_t i = 0; i < kRows * kCols; ++i) {
    sum += depths[i] - (2.0F + 0.004F * static_cast<float>(i % kCols) + moved);
  }
  return sum / static_cast<double>(kRows * kCols);
}

TEST(DepthSmoother, FollowsSlowMotion) {
  DepthSmoother smoother;
  std::uint32_t state = 1;
  double error = 0.0;
  for (int i = 0; i < 30; ++i) {
    const float moved = 0.004F * static_cast<float>(i);
    error = mean_error(smoother.add(view(wall(moved, state))), moved);
    EXPECT_EQ(smoother.starts_anew(), i == 0);
  }
  EXPECT_LT(std::abs(error), 0.012);  // a mean over time lags by 23 mm
}

/// Motion of 1.2 mm per frame, less than the noise of the mean of 25 pixels (3 mm): it is
/// detectable only in more pixels.
TEST(DepthSmoother, FollowsMotionBelowTheNoise) {
  DepthSmoother smoother;
  std::uint32_t state = 1;
  double error = 0.0;
  for (int i = 0; i < 40; ++i) {
    const float moved = 0.0012F * static_cast<float>(i);
    error = mean_error(smoother.add(view(wall(moved, state))), moved);
  }
  EXPECT_LT(std::abs(error), 0.003);  // measured: 1.2 mm; 4.5 mm with means of 25 pixels only
}

TEST(DepthSmoother, StartsAnewWithAnotherView) {
  DepthSmoother smoother;
  std::uint32_t state = 1;
  for (int i = 0; i < 4; ++i) smoother.add(view(wall(0.0F, state)));
  smoother.add(view(wall(1.0F, state)));
  EXPECT_TRUE(smoother.starts_anew());
  smoother.add(view(wall(1.0F, state)));
  EXPECT_FALSE(smoother.starts_anew());
}

TEST(DepthSmoother, StartsAnewWithoutSmoothing) {
  DepthSmoother smoother({.newest_share = 1.0});
  std::uint32_t state = 1;
  for (const bool is_first : {true, false, false}) {
    const std::vector<float> depths = wall(0.0F, state);
    EXPECT_EQ(smoother.add(view(depths)), depths);
    EXPECT_EQ(smoother.starts_anew(), is_first);
  }
  smoother.add(view(wall(1.0F, state)));
  EXPECT_TRUE(smoother.starts_anew());
}

TEST(DepthSmoother, ABlankFirstFrameStartsAnew) {
  DepthSmoother smoother;
  smoother.add(view(std::vector<float>(kRows * kCols)));
  EXPECT_TRUE(smoother.starts_anew());
}

TEST(DepthSmoother, WrongDepthsComeBackAndNanIsZero) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  const std::vector<float> depths{kInfinity, std::nanf(""), -1.0F, 2.0F};
  DepthSmoother smoother;
  EXPECT_EQ(smoother.add({.rows = 2, .cols = 2, .metres = depths.data()}),
            (std::vector<float>{kInfinity, 0.0F, -1.0F, 2.0F}));
}

TEST(DepthSmoother, AMeshThatIsRefusedLeavesTheOneBefore) {
  Rows<std::int32_t, 2> pixels(4, 2);
  pixels << 0, 0, kCols - 1, 0, 0, kRows - 1, kCols - 1, kRows - 1;
  Rows<std::int32_t, 3> faces(2, 3), wrong(2, 3);
  faces << 0, 1, 2, 1, 3, 2;
  wrong << 0, 1, 2, 1, 3, 9;
  const std::vector<float> shown(4, 2.1F), other(4, 2.12F);
  DepthSmoother smoother, undisturbed;
  std::uint32_t state = 1;
  for (int i = 0; i < 8; ++i) {
    const std::vector<float> depths = wall(0.0F, state);
    EXPECT_EQ(smoother.add(view(depths)), undisturbed.add(view(depths)));
    smoother.show(pixels, shown, faces);
    undisturbed.show(pixels, shown, faces);
    EXPECT_THROW(smoother.show(pixels, other, wrong), InputError);
  }
}

TEST(DepthSmoother, TakesAnyDepths) {
  constexpr float kLargest = std::numeric_limits<float>::max();
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  for (const std::int64_t side : {1, 3, 5, 9, 17}) {
    for (const float depth : {0.0F, 1e-30F, 1.0F, kLargest, kNan}) {
      DepthSmoother smoother;
      std::vector<float> depths(side * side, depth);
      for (int i = 0; i < 4; ++i) {
        depths[i % depths.size()] = i % 2 == 0 ? 1.0F : kLargest;
        const std::vector<float>& found =
            smoother.add({.rows = side, .cols = side, .metres = depths.data()});
        for (const float z : found) EXPECT_FALSE(std::isnan(z));
      }
    }
  }
}

}  // namespace
}  // namespace manip3d
