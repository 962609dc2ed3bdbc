#include "manip3d/geometry/range_image.hpp"

#include <algorithm>
#include <string>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

std::string at_pixel(std::int64_t u, std::int64_t v) {
  return " at row " + std::to_string(v) + ", column " + std::to_string(u);
}

/// The bounding box of the measured pixels; `is_set` must be false for 0 and NaN.
template <typename Scalar, typename IsSet>
PixelBox find_bounds(const Scalar* pixels, std::int64_t rows, std::int64_t cols,
                     const IsSet& is_set) {
  const auto any_in_row = [&](std::int64_t v) {
    int any = 0;  // no early exit, so that the loop is vectorized
    for (std::int64_t u = 0; u < cols; ++u) any |= is_set(pixels[v * cols + u]) ? 1 : 0;
    return any != 0;
  };
  std::int64_t first = 0, last = rows;
  while (first < last && !any_in_row(first)) ++first;
  while (last > first && !any_in_row(last - 1)) --last;
  std::int64_t left = cols, right = 0;
  for (std::int64_t v = first; v < last; ++v) {
    const Scalar* row = pixels + v * cols;
    std::int64_t u = 0;
    while (u < left && !is_set(row[u])) ++u;
    left = std::min(left, u);
    u = cols;
    while (u > right && !is_set(row[u - 1])) --u;
    right = std::max(right, u);
  }
  if (left >= right) return {};
  return {left, first, right - left, last - first};
}

}  // namespace

RangeImage::RangeImage(const DepthView& depth, const PixelRays& rays)
    : depth_(depth), rays_(&rays) {
  if (depth.rows != rays.height() || depth.cols != rays.width()) {
    throw InputError("depth: expected shape (" + std::to_string(rays.height()) + ", " +
                     std::to_string(rays.width()) + ") as the intrinsics say, got (" +
                     std::to_string(depth.rows) + ", " + std::to_string(depth.cols) + ")");
  }
  grid_.rows = depth.rows;
  grid_.cols = depth.cols;
  grid_.rows_up = rays.flips();
}

RangeImage::RangeImage(const PointGridView& grid) : grid_(grid) {
  if (grid.rows > kMaxImageSide || grid.cols > kMaxImageSide) {
    throw InputError("points: expected at most 16384 rows and columns, got " +
                     std::to_string(grid.rows) + " x " + std::to_string(grid.cols));
  }
}

PixelBox RangeImage::bounds() const {
  if (depth_.millimetres != nullptr) {
    return find_bounds(depth_.millimetres, rows(), cols(), [](std::uint16_t z) { return z != 0; });
  }
  if (depth_.metres != nullptr) {  // values that are rejected later count as well
    return find_bounds(depth_.metres, rows(), cols(), [](float z) { return z != 0.0F && z == z; });
  }
  return find_bounds(grid_.valid, rows(), cols(), [](std::uint8_t valid) { return valid != 0; });
}

void RangeImage::load_depth(std::int64_t v, std::int64_t u0, std::int64_t count, float* z) const {
  if (depth_.millimetres != nullptr) {
    const std::uint16_t* in = depth_.millimetres + v * cols() + u0;
    for (std::int64_t i = 0; i < count; ++i) {
      // Divided, not multiplied by 0.001, to get the float nearest to the measured value.
      z[i] = in[i] != 0 ? static_cast<float>(in[i]) / 1000.0F : kNanF;
    }
    return;
  }
  const float* in = depth_.metres + v * cols() + u0;
  int refused = 0;
  for (std::int64_t i = 0; i < count; ++i) {
    const float depth = in[i];
    refused |= static_cast<int>(depth < 0.0F) | static_cast<int>(depth == kInfinityF);
    z[i] = depth > 0.0F ? depth : kNanF;
  }
  for (std::int64_t i = 0; refused != 0 && i < count; ++i) {
    if (in[i] < 0.0F || in[i] == kInfinityF) {
      throw InputError("depth: expected finite numbers >= 0, or NaN, got " + number_text(in[i]) +
                       at_pixel(u0 + i, v));
    }
  }
}

void RangeImage::load_points(std::int64_t v, std::int64_t u0, std::int64_t count, float* x,
                             float* y, float* z) const {
  const float* in = grid_.points + 3 * (v * cols() + u0);
  const std::uint8_t* valid = grid_.valid + v * cols() + u0;
  int refused = 0;
  for (std::int64_t i = 0; i < count; ++i) {
    const bool measured = valid[i] != 0;
    x[i] = measured ? in[3 * i] : kNanF;
    y[i] = measured ? in[3 * i + 1] : kNanF;
    z[i] = measured ? in[3 * i + 2] : kNanF;
    const float sum = (in[3 * i] - in[3 * i]) + (in[3 * i + 1] - in[3 * i + 1]) +
                      (in[3 * i + 2] - in[3 * i + 2]);  // 0 for finite numbers, else NaN
    refused |= static_cast<int>(measured) & static_cast<int>(sum != 0.0F);
  }
  if (refused == 0) return;
  for (std::int64_t i = 0; i < count; ++i) {
    const float* p = in + 3 * i;
    if (valid[i] != 0 && !((p[0] - p[0]) + (p[1] - p[1]) + (p[2] - p[2]) == 0.0F)) {
      throw InputError("points: expected finite coordinates where valid, got NaN or infinity" +
                       at_pixel(u0 + i, v));
    }
  }
}

void RangeImage::load_row(std::int64_t v, std::int64_t u0, std::int64_t count, float* x, float* y,
                          float* z) const {
  if (rays_ == nullptr) {
    load_points(v, u0, count, x, y, z);
    return;
  }
  load_depth(v, u0, count, z);
  const float* ray_x = rays_->x(v) + u0;
  if (rays_->is_separable()) {
    const float ray_y = *rays_->y(v);
    for (std::int64_t i = 0; i < count; ++i) {
      x[i] = ray_x[i] * z[i];
      y[i] = ray_y * z[i];
    }
    return;
  }
  const float* ray_y = rays_->y(v) + u0;
  for (std::int64_t i = 0; i < count; ++i) {
    x[i] = ray_x[i] * z[i];
    y[i] = ray_y[i] * z[i];
    const float sum = x[i] + y[i];  // NaN where the pixel has no ray
    z[i] = sum == sum ? z[i] : kNanF;
  }
}

std::array<float, 3> RangeImage::point(std::int64_t u, std::int64_t v) const {
  std::array<float, 3> p{};
  load_row(v, u, 1, p.data(), &p[1], &p[2]);
  return p;
}

}  // namespace manip3d
