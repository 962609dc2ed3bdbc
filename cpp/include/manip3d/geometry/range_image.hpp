#pragma once

#include <array>
#include <cstdint>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// A rectangle of pixels.
struct PixelBox {
  std::int64_t u0 = 0, v0 = 0;
  std::int64_t width = 0, height = 0;
  [[nodiscard]] bool empty() const { return width == 0 || height == 0; }
};

/// Common view of depth images and range scans: at most one point per pixel, borrowed. Points of a
/// depth image are computed on demand, with the same bits as unproject().
class RangeImage {
 public:
  /// Sizes must agree; both arguments are borrowed.
  /// @throws InputError  sizes differ.
  RangeImage(const DepthView& depth, const PixelRays& rays);
  /// @throws InputError  a side above kMaxImageSide.
  explicit RangeImage(const PointGridView& grid);

  [[nodiscard]] std::int64_t rows() const { return grid_.rows; }
  [[nodiscard]] std::int64_t cols() const { return grid_.cols; }
  /// The grid's PointGridView::rows_up.
  [[nodiscard]] bool rows_up() const { return grid_.rows_up; }
  /// Whether it is a depth image, so that z is the distance from the sensor.
  [[nodiscard]] bool has_depth() const { return rays_ != nullptr; }

  /// The smallest box around all pixels that may be valid; pixels outside are not valid.
  [[nodiscard]] PixelBox bounds() const;
  /// Coordinates of the pixels (u0 to u0 + count - 1, v); NaN where there is no measurement.
  /// @throws InputError  a depth that is negative or infinite; a valid point that is not finite.
  void load_row(std::int64_t v, std::int64_t u0, std::int64_t count, float* x, float* y,
                float* z) const;
  /// The z of a valid pixel of a depth image, metres.
  [[nodiscard]] float depth(std::int64_t u, std::int64_t v) const {
    const std::int64_t pixel = v * grid_.cols + u;
    // Divided, not multiplied by 0.001, to get the float nearest to the measured value.
    return depth_.millimetres != nullptr ? static_cast<float>(depth_.millimetres[pixel]) / 1000.0F
                                         : depth_.metres[pixel];
  }
  /// The point of a valid pixel.
  [[nodiscard]] std::array<float, 3> point(std::int64_t u, std::int64_t v) const;

 private:
  void load_depth(std::int64_t v, std::int64_t u0, std::int64_t count, float* z) const;
  void load_points(std::int64_t v, std::int64_t u0, std::int64_t count, float* x, float* y,
                   float* z) const;

  DepthView depth_;
  const PixelRays* rays_ = nullptr;  ///< Null for a grid of points.
  PointGridView grid_;
};

}  // namespace manip3d
