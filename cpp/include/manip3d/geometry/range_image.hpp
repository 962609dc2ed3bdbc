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

/// Common view of depth images and range scans: a point per pixel or none, borrowed.
///
/// Points of a depth image are made where they are asked for, with the same bits as unproject().
class RangeImage {
 public:
  /// Sizes must agree; `rays` is borrowed.
  /// @throws InputError  other sizes.
  RangeImage(const DepthView& depth, const PixelRays& rays);
  /// @throws InputError  a side above kMaxImageSide.
  explicit RangeImage(const PointGridView& grid);

  [[nodiscard]] std::int64_t rows() const { return grid_.rows; }
  [[nodiscard]] std::int64_t cols() const { return grid_.cols; }
  /// The grid's PointGridView::rows_up.
  [[nodiscard]] bool rows_up() const { return grid_.rows_up; }
  /// Is it a depth image, so that z is the distance from the sensor?
  [[nodiscard]] bool has_depth() const { return rays_ != nullptr; }

  /// The smallest box around all pixels that may be valid; all others are not.
  [[nodiscard]] PixelBox bounds() const;
  /// Coordinates of the pixels (u0 to u0 + count - 1, v), NaN where nothing is measured.
  /// @throws InputError  a depth that is negative or infinite, a valid point that is not finite.
  void load_row(std::int64_t v, std::int64_t u0, std::int64_t count, float* x, float* y,
                float* z) const;
  /// The z of a valid pixel of a depth image, metres.
  [[nodiscard]] float depth(std::int64_t u, std::int64_t v) const {
    const std::int64_t pixel = v * grid_.cols + u;
    // Division, not times 0.001: the float nearest to the measured value.
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
