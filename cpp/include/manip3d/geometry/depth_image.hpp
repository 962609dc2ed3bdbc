#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// A borrowed depth image, row by row: distance along the optical axis. 0 and NaN mean that there
/// is no measurement. Exactly one of the two pointers is set.
struct DepthView {
  std::int64_t rows = 0, cols = 0;
  const std::uint16_t* millimetres = nullptr;
  const float* metres = nullptr;
  /// Metres at a pixel, row by row; 0 or NaN: no measurement.
  [[nodiscard]] float at(std::int64_t pixel) const {
    return millimetres != nullptr ? static_cast<float>(millimetres[pixel]) / 1000.0F
                                  : metres[pixel];
  }
};

/// A borrowed grid with at most one point per pixel: an unprojected depth image, or a range scan.
struct PointGridView {
  std::int64_t rows = 0, cols = 0;
  const float* points = nullptr;        ///< (rows, cols, 3); read only where valid.
  const std::uint8_t* valid = nullptr;  ///< (rows, cols); 0 = no measurement.
  /// Whether triangles that are counter-clockwise in (column, row) are front faces as seen from the
  /// sensor. True for Stanford's range grids, whose rows go up; false for images, whose rows go
  /// down.
  bool rows_up = false;
};

/// A grid that owns its memory.
struct PointGrid {
  std::int64_t rows = 0, cols = 0;
  Rows<float, 3> points;            ///< NaN where there is no measurement.
  std::vector<std::uint8_t> valid;  ///< 0 or 1.
  bool rows_up = false;
  [[nodiscard]] PointGridView view() const {
    return {rows, cols, points.data(), valid.data(), rows_up};
  }
};

/// Lifts a depth image to points of the camera frame, metres: V(u) = R(u) K^-1 u (dissertation
/// section 3.3.1). Sizes must agree.
/// @throws InputError  other sizes; a depth that is negative or infinite.
PointGrid unproject(const DepthView& depth, const PixelRays& rays, int num_threads = 0);

/// Overload that overwrites `grid` and reuses its memory.
void unproject(const DepthView& depth, const PixelRays& rays, int num_threads, PointGrid& grid);

/// @throws InputError  side above kMaxImageSide; a valid point that is not finite.
void check_point_grid(const PointGridView& grid);

}  // namespace manip3d
