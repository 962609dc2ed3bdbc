#pragma once

#include <pybind11/pybind11.h>

#include "manip3d/geometry/rgbd_frame.hpp"
#include "manip3d/geometry/skeleton.hpp"

namespace manip3d::bindings {

/// Converts a `manip3d.Skeleton`.
Skeleton to_skeleton(const pybind11::handle& skeleton);

/// Converts a `manip3d.RgbdCalibration`, with a copy of the ray table.
RgbdCalibration to_calibration(const pybind11::handle& calibration);

/// Copies a `manip3d.RgbdFrame`, except its calibration, which the caller must set.
void to_frame(const pybind11::handle& from, RgbdFrame& frame);

/// The fields of a `manip3d.Skeleton`.
pybind11::dict from_skeleton(const Skeleton& skeleton);

}  // namespace manip3d::bindings
