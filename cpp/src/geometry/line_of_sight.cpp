#include "manip3d/geometry/line_of_sight.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "geometry/constants.hpp"
#include "geometry/lens.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;

/// The inverse of distort() by fixed-point iteration; NaN if it does not converge.
Vector2d undistort(const std::array<double, 5>& k, const Vector2d& distorted) {
  constexpr int kMaxSteps = 100;
  constexpr double kSettled = 1e-10;  // far below the precision of the float that stores the result
  Vector2d ray = distorted;
  for (int i = 0; i < kMaxSteps; ++i) {
    const Vector2d error = distort(k, ray) - distorted;
    if (error.squaredNorm() < kSettled * kSettled) return ray;
    ray -= error;
  }
  return {kNan, kNan};
}

/// Interpolates between a and b; an end with weight 0 may be NaN.
Vector2d between(const Vector2d& a, const Vector2d& b, double part) {
  if (part == 0.0) return a;
  if (part == 1.0) return b;
  return a + (b - a) * part;
}

/// The ray table of a camera as a function of the pixel, bilinear in each 2x2 cell of pixels.
class RayTable {
 public:
  /// `camera.ray_table` must be set and outlive this.
  explicit RayTable(const Intrinsics& camera)
      : width_(camera.width), height_(camera.height), rays_(camera.ray_table) {}

  /// x/z and y/z at a pixel; NaN beyond half a pixel from the outermost pixels, and beside a NaN.
  [[nodiscard]] Eigen::Vector2d at(const Eigen::Vector2d& pixel) const;

  /// The pixel that looks along `ray`, by Newton's method from `guess` and, if that fails, from the
  /// middle of the table; NaN if there is none.
  [[nodiscard]] Eigen::Vector2d find(const Eigen::Vector2d& ray,
                                     const Eigen::Vector2d& guess) const;

 private:
  /// The cell of a pixel, and the position of the pixel in it, 0 to 1 except at the border.
  struct Place {
    std::int64_t u, v;
    Eigen::Vector2d part;
  };
  [[nodiscard]] Place place(const Eigen::Vector2d& pixel) const;
  [[nodiscard]] Eigen::Vector2d ray(std::int64_t u, std::int64_t v) const;
  [[nodiscard]] Eigen::Vector2d clamped(const Eigen::Vector2d& pixel) const;
  /// Derivatives of the ray by the column (first column of the result) and by the row.
  [[nodiscard]] Eigen::Matrix2d slope(const Eigen::Vector2d& pixel) const;
  [[nodiscard]] Eigen::Vector2d newton(const Eigen::Vector2d& ray, Eigen::Vector2d pixel) const;

  std::int64_t width_, height_;
  const float* rays_;
};

Vector2d RayTable::ray(std::int64_t u, std::int64_t v) const {
  const float* xy = rays_ + 2 * (std::min(v, height_ - 1) * width_ + std::min(u, width_ - 1));
  return {xy[0], xy[1]};
}

RayTable::Place RayTable::place(const Vector2d& pixel) const {
  const auto cell = [](double at, std::int64_t side) {
    const auto last = std::max<std::int64_t>(side - 2, 0);
    return std::clamp(static_cast<std::int64_t>(std::floor(at)), std::int64_t{0}, last);
  };
  const std::int64_t u = cell(pixel.x(), width_), v = cell(pixel.y(), height_);
  return {u, v, pixel - Vector2d(static_cast<double>(u), static_cast<double>(v))};
}

Vector2d RayTable::clamped(const Vector2d& pixel) const {
  return {std::clamp(pixel.x(), -0.5, static_cast<double>(width_) - 0.5),
          std::clamp(pixel.y(), -0.5, static_cast<double>(height_) - 0.5)};
}

Vector2d RayTable::at(const Vector2d& pixel) const {
  if (!(clamped(pixel) == pixel)) return {kNan, kNan};
  const auto [u, v, part] = place(pixel);
  return between(between(ray(u, v), ray(u + 1, v), part.x()),
                 between(ray(u, v + 1), ray(u + 1, v + 1), part.x()), part.y());
}

Eigen::Matrix2d RayTable::slope(const Vector2d& pixel) const {
  const auto [u, v, part] = place(pixel);
  const Vector2d a = ray(u, v), b = ray(u + 1, v), c = ray(u, v + 1), d = ray(u + 1, v + 1);
  Eigen::Matrix2d result;
  result.col(0) = between(b - a, d - c, part.y());
  result.col(1) = between(c - a, d - b, part.x());
  return result;
}

Vector2d RayTable::newton(const Vector2d& ray, Vector2d pixel) const {
  constexpr int kMaxSteps = 50;
  constexpr double kSettled = 1e-8;  // pixels; the table's floats are accurate to about 1e-4
  for (int i = 0; i < kMaxSteps; ++i) {
    const Vector2d step = slope(pixel).inverse() * (at(pixel) - ray);
    if (!step.allFinite()) break;
    const Vector2d next = pixel - step;
    if (step.squaredNorm() < kSettled * kSettled) {
      // A pixel on the table's outer edge may converge to a position outside by less than that.
      return (clamped(next) - next).squaredNorm() < kSettled * kSettled ? next
                                                                        : Vector2d(kNan, kNan);
    }
    pixel = clamped(next);
  }
  return {kNan, kNan};
}

Vector2d RayTable::find(const Vector2d& ray, const Vector2d& guess) const {
  const Vector2d pixel = newton(ray, clamped(guess));
  if (pixel.allFinite()) return pixel;
  return newton(ray,
                0.5 * Vector2d(static_cast<double>(width_ - 1), static_cast<double>(height_ - 1)));
}

}  // namespace

Vector2d line_of_sight(const Intrinsics& camera, const Vector2d& pixel) {
  if (camera.ray_table != nullptr) return RayTable(camera).at(pixel);
  const Vector2d ideal(ideal_x(camera, pixel.x()), ideal_y(camera, pixel.y()));
  return is_distorted(camera) ? undistort(camera.distortion, ideal) : ideal;
}

Vector2d pixel_of(const Intrinsics& camera, const Eigen::Vector3d& point) {
  const Vector2d by_lens = project(camera, point);
  if (camera.ray_table == nullptr || !by_lens.allFinite()) return by_lens;
  return RayTable(camera).find(point.head<2>() / point.z(), by_lens);
}

}  // namespace manip3d
