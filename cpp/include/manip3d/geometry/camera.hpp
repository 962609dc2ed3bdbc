#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

namespace manip3d {

/// Largest side of an image; exact integer predicates need this limit.
inline constexpr std::int64_t kMaxImageSide = 16384;

/// A pinhole camera. Pixel centres lie at integer (u, v); the camera looks along +z, x to the
/// right and y down for positive focal lengths (Hartley & Zisserman, 2nd ed., eq. 6.9).
struct Intrinsics {
  std::int64_t width = 0, height = 0;  ///< Pixels, 1 to kMaxImageSide.
  double fx = 0.0, fy = 0.0;           ///< Pixels; fy < 0 for an image whose y axis points up.
  double cx = 0.0, cy = 0.0;           ///< Principal point, pixels.
  std::array<double, 5> distortion{};  ///< Brown: k1, k2, p1, p2, k3 (OpenCV's order).
  /// (height, width, 2): x/z and y/z of each pixel, instead of the model above; borrowed.
  const float* ray_table = nullptr;
  bool mirrored = false;  ///< The image is flipped left to right: its u grows against x.
};

/// @throws InputError  naming the field of `name`, the expected and the actual value.
void check_intrinsics(const Intrinsics& camera, const char* name = "intrinsics");

/// Return the pixel (u, v) at which a point of the camera frame appears; NaN for z <= 0. Uses the
/// lens model, never the ray table.
Eigen::Vector2d project(const Intrinsics& camera, const Eigen::Vector3d& point);

/// Transform from the pixels of a depth image to those of a colour image.
struct Registration {
  Intrinsics color;                                        ///< Without a ray table.
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  ///< Depth camera to colour camera.
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();   ///< Metres.
};

/// @throws InputError  a matrix that is no rotation, or a number that is not finite.
void check_registration(const Registration& registration);

/// The direction (x, y, 1) in which each pixel looks; NaN where a distorted lens has no ray.
///
/// Without distortion, x depends only on the column and y only on the row; then only these are
/// stored.
class PixelRays {
 public:
  PixelRays() = default;
  /// @throws InputError  as check_intrinsics.
  explicit PixelRays(const Intrinsics& camera);

  /// Pixels in a row; 0 for a default-constructed object.
  [[nodiscard]] std::int64_t width() const { return width_; }
  /// Rows of pixels.
  [[nodiscard]] std::int64_t height() const { return height_; }
  /// Whether x depends only on the column, and y only on the row.
  [[nodiscard]] bool is_separable() const { return separable_; }
  /// x of the pixels of row v: `width` values.
  [[nodiscard]] const float* x(std::int64_t v) const {
    return x_.data() + (separable_ ? 0 : v * width_);
  }
  /// y of the pixels of row v: one value if is_separable(), else `width` values.
  [[nodiscard]] const float* y(std::int64_t v) const {
    return y_.data() + (separable_ ? v : v * width_);
  }
  /// True if exactly one axis of the image runs against the camera's: rows go up (fy < 0), or
  /// columns run to the left (`mirrored`). Triangles that face the camera are then
  /// counter-clockwise in (u, v), else clockwise.
  [[nodiscard]] bool flips() const { return flips_; }

 private:
  std::int64_t width_ = 0, height_ = 0;
  bool separable_ = true, flips_ = false;
  std::vector<float> x_, y_;
};

}  // namespace manip3d
