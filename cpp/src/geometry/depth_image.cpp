#include "manip3d/geometry/depth_image.hpp"

#include <cmath>
#include <limits>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

std::string at_pixel(std::int64_t row, std::int64_t col) {
  return " at row " + std::to_string(row) + ", column " + std::to_string(col);
}

[[noreturn]] void refuse_depth(const float* depth, std::int64_t row, std::int64_t cols) {
  for (std::int64_t u = 0; u < cols; ++u) {
    if (depth[u] < 0.0F || depth[u] == kInfinity) {
      throw InputError("depth: expected finite numbers >= 0, or NaN, got " +
                       std::to_string(depth[u]) + at_pixel(row, u));
    }
  }
  throw InputError("depth: expected finite numbers >= 0, or NaN");
}

}  // namespace

void load_depth_row(const DepthView& depth, std::int64_t row, float* metres) {
  if (depth.millimetres != nullptr) {
    const std::uint16_t* in = depth.millimetres + row * depth.cols;
    for (std::int64_t u = 0; u < depth.cols; ++u) {
      // Division, not times 0.001: the float nearest to the measured value.
      metres[u] = in[u] != 0 ? static_cast<float>(in[u]) / 1000.0F : kNan;
    }
    return;
  }
  const float* in = depth.metres + row * depth.cols;
  int refused = 0;
  for (std::int64_t u = 0; u < depth.cols; ++u) {
    const float z = in[u];
    refused |= static_cast<int>(z < 0.0F) | static_cast<int>(z == kInfinity);
    metres[u] = z > 0.0F ? z : kNan;
  }
  if (refused != 0) refuse_depth(in, row, depth.cols);
}

PointGrid unproject(const DepthView& depth, const PixelRays& rays, int num_threads) {
  if (depth.rows != rays.height() || depth.cols != rays.width()) {
    throw InputError("depth: expected shape (" + std::to_string(rays.height()) + ", " +
                     std::to_string(rays.width()) + ") as the intrinsics say, got (" +
                     std::to_string(depth.rows) + ", " + std::to_string(depth.cols) + ")");
  }
  PointGrid grid;
  grid.rows = depth.rows;
  grid.cols = depth.cols;
  grid.rows_up = rays.flips();
  grid.points.resize(depth.rows * depth.cols, 3);
  grid.valid.resize(static_cast<std::size_t>(depth.rows * depth.cols));
  constexpr std::int64_t kRowsPerChunk = 16;
  parallel_chunks(depth.rows, kRowsPerChunk, num_threads, [&](std::int64_t v0, std::int64_t v1) {
    std::vector<float> z(static_cast<std::size_t>(depth.cols));
    for (std::int64_t v = v0; v < v1; ++v) {
      load_depth_row(depth, v, z.data());
      const float* ray_x = rays.x(v);
      const float* ray_y = rays.y(v);
      float* point = grid.points.data() + v * depth.cols * 3;
      std::uint8_t* valid = grid.valid.data() + v * depth.cols;
      for (std::int64_t u = 0; u < depth.cols; ++u, point += 3) {
        const float metres = z[static_cast<std::size_t>(u)];
        point[0] = ray_x[u] * metres;
        point[1] = ray_y[rays.is_separable() ? 0 : u] * metres;
        valid[u] = std::isfinite(point[0]) && std::isfinite(point[1]) ? 1 : 0;
        point[2] = valid[u] != 0 ? metres : kNan;
        if (valid[u] == 0) point[0] = point[1] = kNan;
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
  for (std::int64_t i = 0; i < grid.rows * grid.cols; ++i) {
    const float* p = grid.points + 3 * i;
    if (grid.valid[i] != 0 &&
        !(std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]))) {
      throw InputError("points: expected finite coordinates where valid, got NaN or infinity" +
                       at_pixel(i / grid.cols, i % grid.cols));
    }
  }
}

}  // namespace manip3d
