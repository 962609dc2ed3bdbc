#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/skeleton.hpp"

namespace manip3d {

/// Data that are the same for all frames. Cameras are not mirrored: a source whose sensor delivers
/// mirrored images or y-up skeletons converts them.
struct RgbdCalibration {
  Intrinsics depth;
  /// Pose and lens of the colour camera; no value: the colour image has the pixels of the depth
  /// image.
  std::optional<Registration> registration;
  std::vector<float> ray_table;  ///< Memory of depth.ray_table.
};

/// Data of an RGB-D camera at one moment. Images are stored row by row.
struct RgbdFrame {
  std::int64_t number = 0;   ///< Frame counter of the sensor; gaps show lost frames.
  std::int64_t time_ns = 0;  ///< Time of the depth image by the sensor's clock.
  /// Time at which a grab thread received the frame from the camera, nanoseconds since 1970 by this
  /// machine's clock; 0: unknown.
  std::int64_t grabbed_ns = 0;
  std::int64_t rows = 0, cols = 0;       ///< Shape of depth and body_index.
  std::vector<std::uint16_t> depth;      ///< Millimetres along the optical axis; 0: no measurement.
  std::vector<std::uint8_t> body_index;  ///< Number of the person, or kNoBody; may be empty.
  std::int64_t color_rows = 0, color_cols = 0;
  std::vector<std::uint8_t> color;  ///< (color_rows, color_cols, 3) R, G, B; may be empty.
  std::vector<Skeleton> skeletons;
  std::shared_ptr<const RgbdCalibration> calibration;
};

}  // namespace manip3d
