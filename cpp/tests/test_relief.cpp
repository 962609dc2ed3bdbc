#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "allocations.hpp"
#include "manip3d/error.hpp"
#include "manip3d/simplify/relief.hpp"
#include "simplify/relief_coverage.hpp"

namespace manip3d {
namespace {

using testing::kCountsAllocations;
using testing::num_allocations;

constexpr std::int64_t kCols = 160, kRows = 120;

// Waves that sway, with other noise in each frame and a hole that wanders.
PointGrid sway(int frame) {
  PointGrid grid;
  grid.rows = kRows;
  grid.cols = kCols;
  grid.points.resize(kRows * kCols, 3);
  grid.valid.assign(kRows * kCols, 1);
  std::uint32_t noise = 12345U + static_cast<std::uint32_t>(frame);
  for (std::int64_t v = 0; v < kRows; ++v) {
    for (std::int64_t u = 0; u < kCols; ++u) {
      noise = noise * 1664525U + 1013904223U;
      const auto x = static_cast<float>(u), y = static_cast<float>(v);
      const float wave = 4.0F * std::sin((x + static_cast<float>(frame)) / 9.0F);
      const float z = 200.0F + wave * std::cos(y / 7.0F) + 1e-10F * static_cast<float>(noise);
      grid.points.row(v * kCols + u) << x, y, z;
      const float from_hole = std::hypot(x - 60.0F - static_cast<float>(frame), y - 50.0F);
      if (from_hole < 14.0F) grid.valid[v * kCols + u] = 0;
    }
  }
  return grid;
}

TEST(Relief, AllocatesNothingButTheResultAfterTheTenthFrame) {
  if (!kCountsAllocations) GTEST_SKIP() << "sanitizers allocate in their own way";
  std::vector<PointGrid> frames;
  for (int frame = 0; frame < 24; ++frame) frames.push_back(sway(frame % 8));
  for (const auto effort : {ReliefEffort::kLive, ReliefEffort::kBalanced, ReliefEffort::kFine}) {
    Relief relief;
    ReliefOptions options;
    options.target_points = 700;
    options.effort = effort;
    options.move_points = true;
    options.stability = 30.0;
    ReliefResult result;
    for (std::size_t frame = 0; frame < frames.size(); ++frame) {
      const std::int64_t before = num_allocations();
      relief.run(frames[frame].view(), options, result);
      // The number of triangles follows the silhouette: their array is the result's own.
      if (frame >= 10) {
        EXPECT_LE(num_allocations() - before, 1) << "frame " << frame;
      }
      EXPECT_EQ(result.mesh.vertices.rows(), 700);
      EXPECT_GT(result.mesh.faces.rows(), 1200);
    }
  }
}

/// A slope, flat in 1 / z, whose columns 2 to 7 were not measured.
PointGrid slope_with_a_gap() {
  constexpr std::int64_t kSize = 12;
  PointGrid grid;
  grid.rows = grid.cols = kSize;
  grid.points.resize(kSize * kSize, 3);
  grid.valid.assign(kSize * kSize, 1);
  for (std::int64_t v = 0; v < kSize; ++v) {
    for (std::int64_t u = 0; u < kSize; ++u) {
      const float z = 1.0F / (1.0F - 0.043F * static_cast<float>(u));
      grid.points.row(v * kSize + u) << 0.01F * static_cast<float>(u) * z,
          0.01F * static_cast<float>(v) * z, z;
      if (u >= 2 && u <= 7) grid.valid[v * kSize + u] = 0;
    }
  }
  return grid;
}

TEST(Relief, TrianglesAcrossAStepMustBeSeenForTheMostPart) {
  const PointGrid grid = slope_with_a_gap();
  relief_detail::Surface surface;
  DenseRule rule;
  rule.max_step = 0.1;
  surface.assign(grid.view(), rule, {}, 1);
  const auto pixel = [&](int u, int v) {
    return static_cast<std::int32_t>(v * surface.cols() + u);
  };
  // No pixel lies off them: 30 pixels of the first are seen and 45 not, 42 of the other and 33 not.
  EXPECT_TRUE(relief_detail::lies_off(surface, {pixel(0, 0), pixel(11, 0), pixel(0, 11)}));
  EXPECT_FALSE(relief_detail::lies_off(surface, {pixel(11, 0), pixel(11, 11), pixel(0, 0)}));
}

TEST(Relief, ForgetsTheFrameBeforeAndReusesItsResult) {
  const PointGrid first = sway(0), second = sway(5);
  ReliefOptions options;
  options.target_points = 300;
  options.stability = 30.0;
  const ReliefResult alone = relief(second.view(), options);
  Relief solver;
  ReliefResult result;
  solver.run(first.view(), options, result);
  solver.reset();
  solver.run(second.view(), options, result);
  EXPECT_EQ(result.mesh.pixels, alone.mesh.pixels);
  EXPECT_EQ(result.mesh.faces, alone.mesh.faces);
}

TEST(Relief, LevelsAreNestedInOneVertexBuffer) {
  const PointGrid grid = sway(0);
  ReliefOptions options;
  options.target_points = 400;
  options.levels = {200, 100, 99, 3};  // a mesh around a hole needs more than three
  const ReliefResult result = relief(grid.view(), options);
  ASSERT_EQ(result.levels.size(), 4U);
  std::int64_t larger = result.mesh.vertices.rows();
  for (std::size_t i = 0; i < result.levels.size(); ++i) {
    const ReliefLevel& level = result.levels[i];
    EXPECT_LE(level.num_vertices, std::min(options.levels[i], larger));
    if (level.faces.size() > 0) {
      EXPECT_EQ(level.faces.maxCoeff() + 1, level.num_vertices);
    }
    larger = level.num_vertices;
  }
}

TEST(Relief, RefusesWhatMakesNoSense) {
  const PointGrid grid = sway(0);
  ReliefOptions options;
  options.target_points = 2;
  EXPECT_THROW(relief(grid.view(), options), InputError);
  options.target_points = 50;
  options.levels = {50};
  EXPECT_THROW(relief(grid.view(), options), InputError);
  options.levels.clear();
  options.stability = std::nan("");
  EXPECT_THROW(relief(grid.view(), options), InputError);
}

}  // namespace
}  // namespace manip3d
