#pragma once

#include <pybind11/pybind11.h>

#include <cstdint>
#include <optional>
#include <string>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/color_image.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "numpy.hpp"

namespace manip3d::bindings {

/// Checks that an array has the shape (H, W, channels), or (H, W) for 0 channels.
template <typename T>
void check_image(const CArray<T>& array, py::ssize_t channels, const char* name) {
  const py::ssize_t dimensions = channels == 0 ? 2 : 3;
  if (array.ndim() != dimensions || (channels > 0 && array.shape(2) != channels)) {
    throw InputError(std::string(name) + ": expected shape (H, W" +
                     (channels == 0 ? std::string() : ", " + std::to_string(channels)) + ")");
  }
}

/// A borrowed depth image.
DepthView depth_view(const py::array& depth);

/// A borrowed colour image; without an image, it has no pixels.
inline ColorView color_view(const std::optional<CArray<std::uint8_t>>& image, const char* name) {
  if (!image) return {};
  check_image(*image, 3, name);
  return {image->shape(0), image->shape(1), image->data()};
}

/// Converts a `manip3d.Intrinsics`; `keep` owns its ray table.
Intrinsics to_intrinsics(const py::object& camera, py::object& keep);

/// Converts a `manip3d.Registration`.
Registration to_registration(const py::object& registration);

/// The arrays of a grid of points, which are kept alive while the GIL is released.
struct BorrowedGrid {
  CArray<float> points;
  CArray<bool> valid;
  PointGridView view;

  BorrowedGrid(const CArray<float>& points_in, const CArray<bool>& valid_in, bool rows_up)
      : points(points_in), valid(valid_in) {
    check_image(points, 3, "points");
    check_image(valid, 0, "valid");
    if (valid.shape(0) != points.shape(0) || valid.shape(1) != points.shape(1)) {
      throw InputError("valid: expected as many rows and columns as points");
    }
    view = {points.shape(0), points.shape(1), points.data(),
            reinterpret_cast<const std::uint8_t*>(valid.data()), rows_up};
  }
};

}  // namespace manip3d::bindings
