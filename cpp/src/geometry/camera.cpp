#include "manip3d/geometry/camera.hpp"

#include <Eigen/LU>
#include <cmath>
#include <string>

#include "geometry/constants.hpp"
#include "geometry/lens.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/line_of_sight.hpp"

namespace manip3d {
namespace {

[[noreturn]] void refuse(const char* name, const char* field, const char* expected, double got) {
  throw InputError(std::string(name) + "." + field + ": expected " + expected + ", got " +
                   number_text(got));
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
  check_intrinsics(registration.color, "registration.color");
  if (registration.color.ray_table != nullptr) {
    throw InputError("registration.color: expected a lens model, got a ray table");
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
  separable_ = camera.ray_table == nullptr && !is_distorted(camera);
  flips_ = (camera.fy < 0.0) != camera.mirrored;
  if (separable_) {
    x_.resize(width_);
    y_.resize(height_);
    for (std::int64_t u = 0; u < width_; ++u) {
      x_[u] = static_cast<float>(ideal_x(camera, static_cast<double>(u)));
    }
    for (std::int64_t v = 0; v < height_; ++v) {
      y_[v] = static_cast<float>(ideal_y(camera, static_cast<double>(v)));
    }
    return;
  }
  const std::size_t size = width_ * height_;
  x_.resize(size);
  y_.resize(size);
  for (std::size_t i = 0; i < size; ++i) {
    if (camera.ray_table != nullptr) {
      x_[i] = camera.ray_table[2 * i];
      y_[i] = camera.ray_table[2 * i + 1];
      continue;
    }
    const auto pixel = static_cast<std::int64_t>(i);
    const Eigen::Vector2d ray = line_of_sight(
        camera, {static_cast<double>(pixel % width_), static_cast<double>(pixel / width_)});
    x_[i] = static_cast<float>(ray.x());
    y_[i] = static_cast<float>(ray.y());
  }
  if (camera.ray_table != nullptr && width_ > 1 && height_ > 1) {
    // The directions of columns and rows are measured in the middle of the table.
    const std::size_t middle = (height_ - 1) / 2 * width_ + (width_ - 1) / 2;
    const auto below = middle + static_cast<std::size_t>(width_);
    const float turn = (x_[middle + 1] - x_[middle]) * (y_[below] - y_[middle]) -
                       (y_[middle + 1] - y_[middle]) * (x_[below] - x_[middle]);
    flips_ = turn < 0.0F;
  }
}

}  // namespace manip3d
