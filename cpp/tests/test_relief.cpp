#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <map>
#include <numeric>
#include <set>
#include <utility>
#include <vector>

#include "allocations.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/grid_mesh.hpp"
#include "manip3d/simplify/relief.hpp"
#include "simplify/relief/coverage.hpp"
#include "simplify/relief/raster.hpp"
#include "simplify/relief/start.hpp"
#include "simplify/relief/surface.hpp"

namespace manip3d {
namespace {

using testing::kCountsAllocations;
using testing::num_allocations;

constexpr std::int64_t kCols = 160, kRows = 120;

// Swaying waves, with new noise in each frame and a moving hole.
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

// A surface that is rebuilt only around filled pixels equals that of the whole grid, to the bit.
TEST(ReliefSurface, BuildsOnlyWhatIsAroundFilledPixels) {
  using relief_detail::Surface;
  PointGrid grid = sway(3);
  std::vector<std::int32_t> filled;
  // Pixels at each border and corner, without changing the bounding box, in pairs, and beside the
  // large hole.
  for (const auto& [u, v] : std::vector<std::array<int, 2>>{{0, 40},
                                                            {1, 0},
                                                            {kCols - 1, 70},
                                                            {80, kRows - 1},
                                                            {90, 90},
                                                            {91, 90},
                                                            {92, 91},
                                                            {63, 64}}) {
    filled.push_back(static_cast<std::int32_t>(v * kCols + u));
  }
  PointGrid with_holes = grid;
  std::vector<float> confidence(kCols * kRows, 1.0F);
  for (const std::int32_t p : filled) {
    with_holes.valid[p] = 0;
    grid.points(p, 2) = 200.0F;
    grid.valid[p] = 1;
    confidence[p] = 0.0F;
  }
  for (const double max_step : {0.01, std::numeric_limits<double>::infinity()}) {
    DenseRule rule;
    rule.max_step = max_step;
    Surface before, quick, whole;
    before.assign(with_holes.view(), rule, {}, 1);
    ASSERT_TRUE(quick.assign_filled(before, grid.view(), rule, confidence, filled));
    whole.assign(grid.view(), rule, confidence, 1);
    EXPECT_EQ(quick.num_faces(), whole.num_faces());
    EXPECT_EQ(quick.num_used(), whole.num_used());
    EXPECT_EQ(quick.num_valid(), whole.num_valid());
    EXPECT_EQ(quick.mean_area(), whole.mean_area());
    ASSERT_EQ(quick.num_pixels(), whole.num_pixels());
    EXPECT_TRUE(std::ranges::equal(quick.cells(), whole.cells()));
    EXPECT_TRUE(std::ranges::equal(quick.used(), whole.used()));
    for (std::int32_t p = 0; p < static_cast<std::int32_t>(whole.num_pixels()); ++p) {
      EXPECT_EQ(quick.sample(p).point(), whole.sample(p).point());
      EXPECT_EQ(quick.sample(p).weight, whole.sample(p).weight);
      EXPECT_EQ(quick.is_valid(p), whole.is_valid(p));
    }
    // A pixel that defines the bounding box changes every sample.
    grid.points(filled[4], 2) = 300.0F;
    EXPECT_FALSE(quick.assign_filled(before, grid.view(), rule, confidence, filled));
    grid.points(filled[4], 2) = 200.0F;
  }
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
    options.num_threads = 1;
    options.move_points = true;
    options.stability = 30.0;
    ReliefResult result;
    for (std::size_t frame = 0; frame < frames.size(); ++frame) {
      const std::int64_t before = num_allocations();
      relief.run(frames[frame].view(), options, result);
      // The number of triangles depends on the silhouette, and their array belongs to the result.
      // With the larger efforts, the first mesh still grows at frame 10, the third frame of the
      // second period.
      if (frame >= (effort == ReliefEffort::kLive ? 10U : 11U)) {
        EXPECT_LE(num_allocations() - before, 1) << "frame " << frame;
      }
      EXPECT_EQ(result.mesh.vertices.rows(), 700);
      EXPECT_GT(result.mesh.faces.rows(), 1200);
    }
  }
}

/// A slope that is linear in 1 / z, with columns 2 to 7 not measured.
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
  // No pixel lies off the triangles: the first covers 30 measured and 45 missing pixels, the other
  // 42 and 33.
  EXPECT_TRUE(relief_detail::lies_off(surface, {pixel(0, 0), pixel(11, 0), pixel(0, 11)}));
  EXPECT_FALSE(relief_detail::lies_off(surface, {pixel(11, 0), pixel(11, 11), pixel(0, 0)}));
}

/// Noise with steps between flat parts. Pixels are missing singly, in groups and beside the steps.
PointGrid torn(std::uint32_t seed) {
  constexpr std::int64_t kWide = 61, kHigh = 47;
  PointGrid grid;
  grid.rows = kHigh;
  grid.cols = kWide;
  grid.points.resize(kHigh * kWide, 3);
  grid.valid.assign(kHigh * kWide, 1);
  std::uint32_t noise = seed;
  const auto draw = [&noise] {
    noise = noise * 1664525U + 1013904223U;
    return static_cast<float>(noise >> 8U) / static_cast<float>(1U << 24U);
  };
  for (std::int64_t v = 0; v < kHigh; ++v) {
    for (std::int64_t u = 0; u < kWide; ++u) {
      const auto x = static_cast<float>(u), y = static_cast<float>(v);
      const bool is_near = std::hypot(x - 25.0F, y - 20.0F) < 13.0F + 2.0F * draw();
      const float z = (is_near ? 1.0F : 2.0F) + 0.004F * draw();
      grid.points.row(v * kWide + u) << 0.01F * x * z, 0.01F * y * z, z;
      const float lost = u > 40 ? 0.3F : 0.03F;
      if (draw() < lost || (u > 8 && u < 13 && v > 9 && v < 31)) grid.valid[v * kWide + u] = 0;
    }
  }
  return grid;
}

using PixelEdges = std::map<std::pair<std::int32_t, std::int32_t>, int>;

/// Edges with only one triangle, split at each pixel that they pass through.
PixelEdges contour_of(std::span<const relief_detail::Triangle> faces, int cols) {
  PixelEdges edges;
  for (const relief_detail::Triangle& t : faces) {
    for (std::size_t i = 0; i < 3; ++i) {
      const std::int32_t a = t[i], b = t[(i + 1) % 3];
      const std::int32_t du = b % cols - a % cols, dv = b / cols - a / cols;
      const std::int32_t count = std::gcd(std::abs(du), std::abs(dv));
      const std::int32_t step = dv / count * cols + du / count;
      for (std::int32_t k = 0; k < count; ++k) ++edges[{a + k * step, a + (k + 1) * step}];
    }
  }
  PixelEdges contour;
  for (const auto& [edge, count] : edges) {
    const auto back = edges.find({edge.second, edge.first});
    const int left = count - (back == edges.end() ? 0 : back->second);
    if (left > 0) contour[edge] = left;
  }
  return contour;
}

TEST(StartMesh, CoversWhatTheDenseMeshCoversByBlocksToo) {
  DenseRule rule;
  rule.max_step = 0.1;
  for (std::uint32_t seed = 1; seed <= 12; ++seed) {
    relief_detail::Surface surface;
    surface.assign(torn(seed).view(), rule, {}, 1);
    std::vector<relief_detail::Triangle> dense;
    surface.dense_triangles(dense);
    std::vector<relief_detail::Keep> keep(surface.num_pixels(), relief_detail::Keep::kFree);
    for (std::size_t p = seed; p < keep.size(); p += 17) keep[p] = relief_detail::Keep::kPrefer;
    for (const bool keeps : {false, true}) {
      relief_detail::StartMesh start;
      const std::span<const relief_detail::Keep> kept =
          keeps ? std::span<const relief_detail::Keep>(keep)
                : std::span<const relief_detail::Keep>();
      const auto faces = start.build(surface, 150, 1, kept, true, {});
      EXPECT_EQ(contour_of(faces, surface.cols()), contour_of(dense, surface.cols())) << seed;
      std::set<std::int32_t> vertices;
      for (const relief_detail::Triangle& t : faces) {
        const std::int32_t u1 = surface.u(t[1]) - surface.u(t[0]),
                           v1 = surface.v(t[1]) - surface.v(t[0]),
                           u2 = surface.u(t[2]) - surface.u(t[0]),
                           v2 = surface.v(t[2]) - surface.v(t[0]);
        EXPECT_GT(u1 * v2 - v1 * u2, 0);
        vertices.insert(t.begin(), t.end());
      }
      if (!keeps) {
        relief_detail::StartMesh other;
        std::set<std::int32_t> more;
        for (const auto& t : other.build(surface, 150, 1, {}, false, {})) {
          more.insert(t.begin(), t.end());
        }
        EXPECT_LT(vertices.size(), more.size()) << seed;
        continue;
      }
      for (std::size_t p = seed; p < keep.size(); p += 17) {
        const auto pixel = static_cast<std::int32_t>(p);
        EXPECT_EQ(vertices.count(pixel), surface.is_used(pixel) ? 1U : 0U) << seed << ' ' << p;
      }
    }
  }
}

TEST(Relief, SliversHaveThePixelsOfTheirTriangles) {
  constexpr std::int32_t kWidth = 40;
  constexpr int kReach = 7;
  const std::array<std::int32_t, 2> from = {20, 20};
  const auto area = [](const auto& a, const auto& b, const auto& c) {
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  };
  for (int direction = 0; direction < 9; ++direction) {
    const std::array<std::int32_t, 2> step = {direction % 3 - 1, direction / 3 - 1};
    const std::array<std::int32_t, 2> to = {from[0] + step[0], from[1] + step[1]};
    for (std::int32_t v = -kReach; v <= kReach; ++v) {
      for (std::int32_t u = -kReach; u <= kReach; ++u) {
        const std::array<std::int32_t, 2> end = {from[0] + u, from[1] + v};
        const std::int32_t turn = area(from, end, to);
        if (turn == 0) continue;
        std::map<std::int32_t, std::pair<bool, bool>> expected, visited;
        relief_detail::visit_pixels(
            kWidth, from, turn > 0 ? end : to, turn > 0 ? to : end,
            relief_detail::SidePixels::kClosed, [&](std::int32_t pixel) {
              const std::array<std::int32_t, 2> p = {pixel % kWidth, pixel / kWidth};
              expected[pixel] = {area(from, end, p) == 0, area(to, end, p) == 0};
            });
        relief_detail::visit_sliver(
            kWidth, from, step, end, [&](std::int32_t pixel, bool on_first, bool on_second) {
              EXPECT_TRUE(visited.insert({pixel, {on_first, on_second}}).second);
            });
        EXPECT_EQ(visited, expected) << direction << ": " << u << ", " << v;
      }
    }
  }
}

TEST(Relief, SurfacesAreTheDenseMeshWhateverTheirWidth) {
  for (std::int64_t cols = 2; cols < 44; ++cols) {
    PointGrid grid = torn(static_cast<std::uint32_t>(cols));
    // Only the last `cols` columns: rows of all lengths, most of which are not multiples of four
    // pixels.
    PointGrid part;
    part.rows = grid.rows;
    part.cols = cols;
    part.points.resize(part.rows * cols, 3);
    for (std::int64_t v = 0; v < part.rows; ++v) {
      for (std::int64_t u = 0; u < cols; ++u) {
        const std::int64_t pixel = v * grid.cols + grid.cols - cols + u;
        part.points.row(v * cols + u) = grid.points.row(pixel);
        part.valid.push_back(grid.valid[pixel]);
      }
    }
    GridMeshOptions dense;
    dense.max_edge = 0.05;
    DenseRule rule;
    rule.max_edge = dense.max_edge;
    relief_detail::Surface surface, threaded;
    surface.assign(part.view(), rule, {}, 1);
    threaded.assign(part.view(), rule, {}, 4);
    const DepthMesh mesh = grid_mesh(part.view(), dense);
    ASSERT_EQ(surface.num_faces(), mesh.faces.rows()) << cols;
    double area = 0.0, weight = 0.0;
    for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
      const Eigen::Vector3d a = mesh.vertices.row(mesh.faces(f, 0)).cast<double>();
      const Eigen::Vector3d b = mesh.vertices.row(mesh.faces(f, 1)).cast<double>();
      const Eigen::Vector3d c = mesh.vertices.row(mesh.faces(f, 2)).cast<double>();
      area += 0.5 * (b - a).cross(c - a).norm();
    }
    std::int64_t used = 0;
    for (std::size_t p = 0; p < surface.num_pixels(); ++p) {
      const auto pixel = static_cast<std::int32_t>(p);
      weight += surface.sample(pixel).weight;
      used += surface.is_used(pixel) ? 1 : 0;
      EXPECT_EQ(threaded.sample(pixel).weight, surface.sample(pixel).weight);
      EXPECT_EQ(threaded.cell(pixel), surface.cell(pixel));
    }
    EXPECT_EQ(used, surface.num_used());
    const auto corners = mesh.faces.reshaped();
    EXPECT_EQ(used, std::ssize(std::set<std::int32_t>(corners.begin(), corners.end())));
    EXPECT_NEAR(weight * surface.unit() * surface.unit(), area, 1e-5 * area) << cols;
  }
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

/// A ridge in whole millimetres with missing pixels.
std::vector<std::uint16_t> ridge(std::int64_t cols, std::int64_t rows) {
  std::vector<std::uint16_t> depth;
  for (std::int64_t v = 0; v < rows; ++v) {
    for (std::int64_t u = 0; u < cols; ++u) {
      const bool is_measured = (5 * u + 3 * v) % 41 != 0;
      depth.push_back(static_cast<std::uint16_t>(is_measured ? 1500 + 7 * std::abs(u - v) : 0));
    }
  }
  return depth;
}

Intrinsics camera_of(std::int64_t cols, std::int64_t rows) {
  Intrinsics camera;
  camera.width = cols;
  camera.height = rows;
  camera.fx = camera.fy = 60.0;
  camera.cx = 20.0;
  camera.cy = 15.0;
  return camera;
}

TEST(Unproject, LeavesPixelsWithoutADepthWithoutAPointWhateverTheWidth) {
  PointGrid grid;  // the same memory for all sizes
  for (std::int64_t cols = 9; cols > 0; --cols) {
    const std::vector<std::uint16_t> depth = ridge(cols, 7);
    DepthView view{7, cols};
    view.millimetres = depth.data();
    unproject(view, PixelRays(camera_of(cols, 7)), 1, grid);
    ASSERT_EQ(grid.points.rows(), 7 * cols);
    for (std::int64_t p = 0; p < 7 * cols; ++p) {
      EXPECT_EQ(grid.valid[p], depth[p] != 0 ? 1 : 0);
      if (depth[p] == 0) {
        EXPECT_TRUE(grid.points.row(p).array().isNaN().all()) << cols;
        continue;
      }
      const float z = static_cast<float>(depth[p]) / 1000.0F;
      EXPECT_FLOAT_EQ(grid.points(p, 0), (static_cast<float>(p % cols) - 20.0F) / 60.0F * z);
      EXPECT_FLOAT_EQ(grid.points(p, 1), (static_cast<float>(p / cols) - 15.0F) / 60.0F * z);
      EXPECT_EQ(grid.points(p, 2), z);
    }
  }
}

TEST(Relief, ADepthImageIsTakenAsItsPoints) {
  ReliefOptions options;
  options.target_points = 60;
  options.effort = ReliefEffort::kLive;
  Relief solver;
  ReliefResult result;
  for (const auto& [cols, rows] : {std::pair(50, 40), std::pair(30, 60), std::pair(50, 40)}) {
    const std::vector<std::uint16_t> depth = ridge(cols, rows);
    DepthView view{rows, cols};
    view.millimetres = depth.data();
    const PixelRays rays(camera_of(cols, rows));
    const ReliefResult alone = relief(unproject(view, rays).view(), options);
    solver.run(view, rays, options, result);
    EXPECT_EQ(result.mesh.vertices, alone.mesh.vertices);
    EXPECT_EQ(result.mesh.faces, alone.mesh.faces);
  }
}

TEST(Relief, LevelsAreNestedInOneVertexBuffer) {
  const PointGrid grid = sway(0);
  ReliefOptions options;
  options.target_points = 400;
  options.levels = {200, 100, 99, 3};  // a mesh around a hole needs more than three vertices
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
