#include "manip3d/geometry/camera.hpp"

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

[[noreturn]] void refuse(const char* name, const char* field, const char* expected, double got) {
  throw InputError(std::string(name) + "." + field + ": expected " + expected + ", got " +
                   std::to_string(got));
}

bool is_distorted(const Intrinsics& camera) {
  for (const double k : camera.distortion) {
    if (k != 0.0) return true;
  }
  return false;
}

/// Brown, "Decentering distortion of lenses", 1966, with OpenCV's names of the coefficients.
Eigen::Vector2d distort(const std::array<double, 5>& k, const Eigen::Vector2d& ray) {
  const double x = ray.x(), y = ray.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  return {x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
          y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y};
}

/// The inverse of distort() by fixed-point iteration; NaN where it does not settle.
Eigen::Vector2d undistort(const std::array<double, 5>& k, const Eigen::Vector2d& distorted) {
  constexpr int kMaxSteps = 100;
  constexpr double kSettled = 1e-10;  // far below the float that keeps the result
  Eigen::Vector2d ray = distorted;
  for (int i = 0; i < kMaxSteps; ++i) {
    const Eigen::Vector2d error = distort(k, ray) - distorted;
    if (error.squaredNorm() < kSettled * kSettled) return ray;
    ray -= error;
  }
  return {kNan, kNan};
}

}  // namespace

void check_intrinsics(const Intrinsics& camera, const char* name) {
  const auto is_side = [](std::int64_t side) { return side >= 1 && side <= kMaxImageSide; };
  if (!is_side(camera.width)) {
    refuse(name, "width", "1 to 16384", static_cast<double>(camera.width));
  }
  if (!is_side(camera.height)) {
    refuse(name, "height", "1 to 16384", static_cast<double>(camera.height));
  }
  if (!(camera.fx > 0.0 && std::isfinite(camera.fx))) {
    refuse(name, "fx", "a finite number > 0", camera.fx);
  }
  if (!(camera.fy != 0.0 && std::isfinite(camera.fy))) {
    refuse(name, "fy", "a finite number other than 0", camera.fy);
  }
  if (!std::isfinite(camera.cx)) refuse(name, "cx", "a finite number", camera.cx);
  if (!std::isfinite(camera.cy)) refuse(name, "cy", "a finite number", camera.cy);
  for (const double k : camera.distortion) {
    if (!std::isfinite(k)) refuse(name, "distortion", "finite numbers", k);
  }
  if (camera.ray_table != nullptr && (camera.mirrored || is_distorted(camera))) {
    throw InputError(std::string(name) +
                     ": a ray table says all about the lens: expected no distortion and "
                     "mirrored = false beside it");
  }
}

void check_registration(const Registration& registration) {
  check_intrinsics(registration.colour, "registration.colour");
  if (registration.colour.ray_table != nullptr) {
    throw InputError("registration.colour: expected a lens model, got a ray table");
  }
  const Eigen::Matrix3d& r = registration.rotation;
  const double defect = (r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!r.allFinite() || !(defect < 1e-3) || !(r.determinant() > 0.0)) {
    throw InputError("registration.rotation: expected a rotation matrix (orthonormal, det 1)");
  }
  if (!registration.translation.allFinite()) {
    throw InputError("registration.translation: expected finite numbers");
  }
}

Eigen::Vector2d project(const Intrinsics& camera, const Eigen::Vector3d& point) {
  if (!(point.z() > 0.0)) return {kNan, kNan};
  const Eigen::Vector2d ray = distort(camera.distortion, point.head<2>() / point.z());
  const double u = camera.fx * ray.x();
  return {camera.mirrored ? camera.cx - u : camera.cx + u, camera.fy * ray.y() + camera.cy};
}

PixelRays::PixelRays(const Intrinsics& camera) : width_(camera.width), height_(camera.height) {
  check_intrinsics(camera);
  const auto ray_x = [&](std::int64_t u) {
    const double x = (static_cast<double>(u) - camera.cx) / camera.fx;
    return camera.mirrored ? -x : x;
  };
  const auto ray_y = [&](std::int64_t v) {
    return (static_cast<double>(v) - camera.cy) / camera.fy;
  };
  separable_ = camera.ray_table == nullptr && !is_distorted(camera);
  flips_ = (camera.fy < 0.0) != camera.mirrored;
  if (separable_) {
    x_.resize(width_);
    y_.resize(height_);
    for (std::int64_t u = 0; u < width_; ++u) {
      x_[u] = static_cast<float>(ray_x(u));
    }
    for (std::int64_t v = 0; v < height_; ++v) {
      y_[v] = static_cast<float>(ray_y(v));
    }
    return;
  }
  const auto size = static_cast<std::size_t>(width_ * height_);
  x_.resize(size);
  y_.resize(size);
  for (std::size_t i = 0; i < size; ++i) {
    if (camera.ray_table != nullptr) {
      x_[i] = camera.ray_table[2 * i];
      y_[i] = camera.ray_table[2 * i + 1];
      continue;
    }
    const auto pixel = static_cast<std::int64_t>(i);
    const Eigen::Vector2d ray =
        undistort(camera.distortion, {ray_x(pixel % width_), ray_y(pixel / width_)});
    x_[i] = static_cast<float>(ray.x());
    y_[i] = static_cast<float>(ray.y());
  }
  if (camera.ray_table != nullptr && width_ > 1 && height_ > 1) {
    // Which way columns and rows run is read off in the middle of the table.
    const auto middle = static_cast<std::size_t>((height_ - 1) / 2 * width_ + (width_ - 1) / 2);
    const auto below = middle + static_cast<std::size_t>(width_);
    const float turn = (x_[middle + 1] - x_[middle]) * (y_[below] - y_[middle]) -
                       (y_[middle + 1] - y_[middle]) * (x_[below] - x_[middle]);
    flips_ = turn < 0.0F;
  }
}

}  // namespace manip3d
