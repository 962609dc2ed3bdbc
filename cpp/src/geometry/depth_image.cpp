#include "manip3d/geometry/depth_image.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <string>

#include "geometry/constants.hpp"
#include "geometry/lanes.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/range_image.hpp"

namespace manip3d {
namespace {

bool is_finite(const float* point) {
  return std::isfinite(point[0]) && std::isfinite(point[1]) && std::isfinite(point[2]);
}

/// Whether all valid points are finite; tests four points, twelve numbers, at a time.
bool all_finite(const PointGridView& grid, std::int64_t num_pixels) {
  constexpr std::int32_t kExponent = 0x7f800000;  // all exponent bits set: infinity or NaN
  const auto are_bad = [](const float* from) -> Int4 {
    Int4 bits;
    std::memcpy(&bits, from, sizeof bits);
    return (bits & kExponent) == kExponent;
  };
  std::int64_t i = 0;
  for (; i + 4 <= num_pixels; i += 4) {
    std::uint32_t valid = 0;
    std::memcpy(&valid, grid.valid + i, sizeof valid);
    if (valid == 0) continue;
    const float* const p = grid.points + 3 * i;
    if (true_lanes(are_bad(p) | are_bad(p + 4) | are_bad(p + 8)) == 0) continue;
    for (std::int64_t k = i; k < i + 4; ++k) {
      if (grid.valid[k] != 0 && !is_finite(grid.points + 3 * k)) return false;
    }
  }
  for (; i < num_pixels; ++i) {
    if (grid.valid[i] != 0 && !is_finite(grid.points + 3 * i)) return false;
  }
  return true;
}

/// Interleaves the coordinates of points; points without a z become NaN.
void write_row(const std::array<const float*, 3>& xyz, std::int64_t size, float* points,
               std::uint8_t* valid) {
  const auto [x, y, z] = xyz;
  const Float4 none = all_of(kNanF);
  std::int64_t u = 0;
  for (; u + 4 <= size; u += 4) {
    const Float4 depth = load4(z + u);
    const Int4 is_valid = depth == depth;
    const auto four =
        transpose({is_valid ? load4(x + u) : none, is_valid ? load4(y + u) : none, depth, none});
    float* const to = points + 3 * u;
    for (std::size_t i = 0; i < 3; ++i)
      store4(to + 3 * i, four[i]);  // the next store overwrites the fourth number
    std::memcpy(to + 9, &four[3], 3 * sizeof(float));
  }
  for (; u < size; ++u) {
    const bool is_valid = z[u] == z[u];
    const std::array<float, 3> point = {is_valid ? x[u] : kNanF, is_valid ? y[u] : kNanF, z[u]};
    std::copy(point.begin(), point.end(), points + 3 * u);
  }
  for (u = 0; u < size; ++u) valid[u] = z[u] == z[u] ? 1 : 0;
}

}  // namespace

PointGrid unproject(const DepthView& depth, const PixelRays& rays, int num_threads) {
  PointGrid grid;
  unproject(depth, rays, num_threads, grid);
  return grid;
}

void unproject(const DepthView& depth, const PixelRays& rays, int num_threads, PointGrid& grid) {
  const RangeImage image(depth, rays);
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
      write_row({&xyz(0, 0), &xyz(1, 0), &xyz(2, 0)}, depth.cols,
                grid.points.data() + 3 * v * depth.cols, grid.valid.data() + v * depth.cols);
    }
  });
}

void check_point_grid(const PointGridView& grid) {
  if (grid.rows > kMaxImageSide || grid.cols > kMaxImageSide) {
    throw InputError("points: expected at most 16384 rows and columns, got " +
                     std::to_string(grid.rows) + " x " + std::to_string(grid.cols));
  }
  const std::int64_t num_pixels = grid.rows * grid.cols;
  if (all_finite(grid, num_pixels)) return;
  for (std::int64_t i = 0; i < num_pixels; ++i) {
    if (grid.valid[i] != 0 && !is_finite(grid.points + 3 * i)) {
      throw InputError(
          "points: expected finite coordinates where valid, got NaN or infinity at row " +
          std::to_string(i / grid.cols) + ", column " + std::to_string(i % grid.cols));
    }
  }
}

}  // namespace manip3d
