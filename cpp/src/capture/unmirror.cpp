#include "manip3d/capture/unmirror.hpp"

#include <algorithm>
#include <cstddef>

namespace manip3d {
namespace {

// A ray table has no flag: it is mirrored if the x of its rays decreases from left to right.
bool is_mirrored(const Intrinsics& camera) {
  if (camera.ray_table == nullptr) return camera.mirrored;
  const float* row = camera.ray_table + camera.height / 2 * camera.width * 2;
  return row[2 * (3 * camera.width / 4)] < row[2 * (camera.width / 4)];
}

void turn_round(Intrinsics& camera) {
  if (camera.mirrored) camera.cx = static_cast<double>(camera.width - 1) - camera.cx;
  camera.mirrored = false;
}

template <typename T>
void reverse_columns(std::vector<T>& image, std::int64_t cols, std::size_t channels) {
  const std::size_t width = static_cast<std::size_t>(cols) * channels;
  for (std::size_t begin = 0; width > 0 && begin < image.size(); begin += width) {
    T* left = image.data() + begin;
    T* right = left + width - channels;
    for (; left < right; left += channels, right -= channels) {
      std::swap_ranges(left, left + channels, right);
    }
  }
}

}  // namespace

std::shared_ptr<const RgbdCalibration> unmirrored(
    const std::shared_ptr<const RgbdCalibration>& calibration) {
  const auto& registration = calibration->registration;
  const bool turn_depth = is_mirrored(calibration->depth);
  if (!turn_depth && !(registration && registration->color.mirrored)) return calibration;
  auto turned = std::make_shared<RgbdCalibration>();
  turned->depth = calibration->depth;
  turned->registration = registration;
  turn_round(turned->depth);
  if (const float* table = calibration->depth.ray_table) {
    turned->ray_table.assign(table, table + 2 * turned->depth.width * turned->depth.height);
    if (turn_depth) reverse_columns(turned->ray_table, turned->depth.width, 2);
    turned->depth.ray_table = turned->ray_table.data();
  }
  if (turned->registration) turn_round(turned->registration->color);
  return turned;
}

Conversions flips_of(const RgbdCalibration& stored) {
  const bool turn_depth = is_mirrored(stored.depth);
  const auto& registration = stored.registration;
  return {turn_depth, registration ? registration->color.mirrored : turn_depth};
}

void unmirror_images(const RgbdCalibration& stored, RgbdFrame& frame) {
  const Conversions flips = flips_of(stored);
  if (flips.flipped_depth) {
    reverse_columns(frame.depth, frame.cols, 1);
    reverse_columns(frame.body_index, frame.cols, 1);
  }
  if (flips.flipped_color) reverse_columns(frame.color, frame.color_cols, 3);
}

}  // namespace manip3d
