#include "manip3d/modify/shoe_cover.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <string>

#include "geometry/median.hpp"
#include "manip3d/error.hpp"
#include "manip3d/modify/joint_smoother.hpp"

namespace manip3d {
namespace {

/// a b / c in OpenCV's fixed point: b / c is rounded to 12 bits, and the product to the nearest
/// integer.
int scaled(int a, int b, int c) {
  constexpr int kBits = 12;
  const int factor = (2 * (b << kBits) + c) / (2 * c);
  return (a * factor + (1 << (kBits - 1))) >> kBits;
}

Eigen::Vector3f point_at(const RgbdFrame& frame, const PixelRays& rays, std::int64_t v,
                         std::int64_t u) {
  const float z = 0.001F * static_cast<float>(frame.depth[v * frame.cols + u]);
  const float y = rays.is_separable() ? *rays.y(v) : rays.y(v)[u];
  return {rays.x(v)[u] * z, y * z, z};
}

/// R, G, B of the colour image at a point of a depth pixel; null outside the image.
const std::uint8_t* color_at(const RgbdFrame& frame, std::int64_t v, std::int64_t u,
                             const Eigen::Vector3f& point) {
  const auto& registration = frame.calibration->registration;
  if (registration) {
    const Eigen::Vector2d pixel =
        project(registration->color,
                registration->rotation * point.cast<double>() + registration->translation);
    const double column = std::round(pixel.x()), row = std::round(pixel.y());
    if (!(column >= 0.0 && column < static_cast<double>(frame.color_cols) && row >= 0.0 &&
          row < static_cast<double>(frame.color_rows))) {
      return nullptr;
    }
    u = static_cast<std::int64_t>(column);
    v = static_cast<std::int64_t>(row);
  }
  return frame.color.data() + 3 * (v * frame.color_cols + u);
}

void check(const RgbdFrame& frame, const PixelRays& rays) {
  if (!frame.calibration) throw InputError("frame: expected a calibration");
  const std::size_t size = frame.rows * frame.cols;
  if (frame.rows != rays.height() || frame.cols != rays.width() || frame.depth.size() != size) {
    throw InputError("frame: expected depth of shape (" + std::to_string(rays.height()) + ", " +
                     std::to_string(rays.width()) + ") as the intrinsics say");
  }
  const auto& registration = frame.calibration->registration;
  const std::int64_t color_rows = registration ? registration->color.height : frame.rows;
  const std::int64_t color_cols = registration ? registration->color.width : frame.cols;
  if (frame.color_rows != color_rows || frame.color_cols != color_cols ||
      frame.color.size() != static_cast<std::size_t>(3 * color_rows * color_cols)) {
    throw InputError("frame: expected colour of shape (" + std::to_string(color_rows) + ", " +
                     std::to_string(color_cols) + ", 3)");
  }
}

}  // namespace

Hsv to_hsv(std::uint8_t red, std::uint8_t green, std::uint8_t blue) {
  const int r = red, g = green, b = blue;
  const int value = std::max({r, g, b});
  const int chroma = value - std::min({r, g, b});
  if (chroma == 0) return {0, 0, value};
  // Sixths of a full turn (red 0, green 2, blue 4) times the chroma.
  const int sixths = value == r ? g - b : value == g ? b - r + 2 * chroma : r - g + 4 * chroma;
  const int hue = scaled(sixths, 30, chroma);
  return {hue < 0 ? hue + 180 : hue, scaled(chroma, 255, value), value};
}

ShoeCoverTracker::ShoeCoverTracker(const ShoeCoverOptions& options) : options_(options) {
  if (!(0 <= options.min_hue && options.min_hue <= options.max_hue && options.max_hue < 180)) {
    throw InputError("hue: expected 0 <= min_hue <= max_hue < 180");
  }
  if (options.min_saturation < 0 || options.min_saturation > 255 || options.min_value < 0 ||
      options.min_value > 255) {
    throw InputError("min_saturation, min_value: expected 0 to 255");
  }
  if (!(options.reach > 0.0 && options.reach <= 10.0)) {
    throw InputError("reach: expected above 0 and up to 10 m, got " + number_text(options.reach));
  }
  if (options.min_pixels < 1) {
    throw InputError("min_pixels: expected at least 1, got " + std::to_string(options.min_pixels));
  }
}

void ShoeCoverTracker::mark(const RgbdFrame& frame, const PixelRays& rays,
                            const Eigen::Vector3f& ankle) {
  blue_.assign(frame.depth.size(), 0);
  last_blue_ = -1;
  const auto reach = static_cast<float>(options_.reach);
  for (std::int64_t v = 0; v < frame.rows; ++v) {
    for (std::int64_t u = 0; u < frame.cols; ++u) {
      const std::int64_t pixel = v * frame.cols + u;
      const float z = 0.001F * static_cast<float>(frame.depth[pixel]);
      if (!(z > 0.0F && std::abs(z - ankle.z()) <= reach)) continue;
      const Eigen::Vector3f point = point_at(frame, rays, v, u);
      if (!((point - ankle).squaredNorm() <= reach * reach)) continue;
      const std::uint8_t* rgb = color_at(frame, v, u, point);
      if (rgb == nullptr) continue;
      const Hsv hsv = to_hsv(rgb[0], rgb[1], rgb[2]);
      if (hsv.hue < options_.min_hue || hsv.hue > options_.max_hue ||
          hsv.saturation < options_.min_saturation || hsv.value < options_.min_value) {
        continue;
      }
      blue_[pixel] = 1;
      if (last_blue_ < 0) first_blue_ = pixel;
      last_blue_ = pixel;
    }
  }
}

void ShoeCoverTracker::take_largest(std::int64_t cols) {
  largest_.clear();
  if (last_blue_ < 0) return;
  const std::int64_t v0 = first_blue_ / cols, v1 = last_blue_ / cols;
  const auto& runs = patches_.find(blue_.data() + v0 * cols, v1 - v0 + 1, cols, false);
  sizes_.assign(patches_.num_components(), 0);
  for (const MarkedRun& run : runs) sizes_[run.component] += run.last - run.first + 1;
  const auto largest = std::max_element(sizes_.begin(), sizes_.end()) - sizes_.begin();
  for (const MarkedRun& run : runs) {
    for (std::int64_t u = run.first; u <= run.last && run.component == largest; ++u) {
      largest_.push_back((v0 + run.row) * cols + u);
    }
  }
}

std::optional<Eigen::Vector3f> ShoeCoverTracker::find(const RgbdFrame& frame, const PixelRays& rays,
                                                      const Eigen::Vector3f& ankle) {
  check(frame, rays);
  mark(frame, rays, ankle);
  take_largest(frame.cols);
  num_pixels_ = static_cast<std::int64_t>(largest_.size());
  if (num_pixels_ < options_.min_pixels) return std::nullopt;
  for (std::vector<float>& values : coordinates_) values.clear();
  for (const std::int64_t pixel : largest_) {
    const Eigen::Vector3f point = point_at(frame, rays, pixel / frame.cols, pixel % frame.cols);
    for (int axis = 0; axis < 3; ++axis) {
      coordinates_[axis].push_back(point[axis]);
    }
  }
  const auto middle = [&](std::size_t axis) {
    return median(std::span(coordinates_[axis]), Middle::kLower);
  };
  return Eigen::Vector3f(middle(0), middle(1), middle(2));
}

bool ShoeCoverTracker::update(const RgbdFrame& frame, const PixelRays& rays, bool left,
                              Skeleton& skeleton) {
  const auto ankle = static_cast<std::size_t>(left ? Joint::kAnkleLeft : Joint::kAnkleRight);
  const auto foot = static_cast<std::size_t>(left ? Joint::kFootLeft : Joint::kFootRight);
  num_pixels_ = 0;
  if (!is_usable(skeleton, static_cast<Joint>(ankle))) return false;
  const auto found = find(frame, rays, skeleton.positions[ankle]);
  if (!found) return false;
  skeleton.positions[foot] = *found;
  skeleton.states[foot] = TrackingState::kTracked;
  return true;
}

}  // namespace manip3d
