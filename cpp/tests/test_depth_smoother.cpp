#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

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
