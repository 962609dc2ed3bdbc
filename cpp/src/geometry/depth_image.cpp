#include "manip3d/geometry/depth_image.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/range_image.hpp"

namespace manip3d {
namespace {

/// Whether all valid points are, without a branch for each.
bool all_finite(const PointGridView& grid, std::int64_t num_pixels) {
  constexpr std::uint32_t kExponent = 0x7f800000U;  // all of it: infinity or NaN
  const auto bits = [](float one) { return std::bit_cast<std::uint32_t>(one) & kExponent; };
  unsigned bad = 0;
  for (std::int64_t i = 0; i < num_pixels; ++i) {
    const float* p = grid.points + 3 * i;
    const std::uint32_t most = std::max({bits(p[0]), bits(p[1]), bits(p[2])});
    bad |= static_cast<unsigned>(grid.valid[i] != 0) & static_cast<unsigned>(most == kExponent);
  }
  return bad == 0;
}

}  // namespace

PointGrid unproject(const DepthView& depth, const PixelRays& rays, int num_threads) {
  const RangeImage image(depth, rays);
  PointGrid grid;
  grid.rows = depth.rows;
  grid.cols = depth.cols;
  grid.rows_up = image.rows_up();
  grid.points.resize(depth.rows * depth.cols, 3);
  grid.valid.resize(depth.rows * depth.cols);
  constexpr std::int64_t kRowsPerChunk = 16;
  parallel_chunks(depth.rows, kRowsPerChunk, num_threads, [&](std::int64_t v0, std::int64_t v1) {
    Rows<float, Eigen::Dynamic> xyz(3, depth.cols);
    for (std::int64_t v = v0; v < v1; ++v) {
      image.load_row(v, 0, depth.cols, &xyz(0, 0), &xyz(1, 0), &xyz(2, 0));
      for (std::int64_t u = 0; u < depth.cols; ++u) {
        const std::int64_t pixel = v * depth.cols + u;
        const bool valid = !std::isnan(xyz(2, u));
        grid.valid[pixel] = valid ? 1 : 0;
        grid.points.row(pixel).setConstant(std::numeric_limits<float>::quiet_NaN());
        if (valid) grid.points.row(pixel) = xyz.col(u).transpose();
      }
    }
  });
  return grid;
}

void check_point_grid(const PointGridView& grid) {
  if (grid.rows > kMaxImageSide || grid.cols > kMaxImageSide) {
    throw InputError("points: expected at most 16384 rows and columns, got " +
                     std::to_string(grid.rows) + " x " + std::to_string(grid.cols));
  }
  const std::int64_t num_pixels = grid.rows * grid.cols;
  if (all_finite(grid, num_pixels)) return;
  for (std::int64_t i = 0; i < num_pixels; ++i) {
    const float* p = grid.points + 3 * i;
    if (grid.valid[i] != 0 &&
        !(std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]))) {
      throw InputError(
          "points: expected finite coordinates where valid, got NaN or infinity at row " +
          std::to_string(i / grid.cols) + ", column " + std::to_string(i % grid.cols));
    }
  }
}

}  // namespace manip3d
