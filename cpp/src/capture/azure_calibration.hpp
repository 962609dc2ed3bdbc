#pragma once

#include <memory>
#include <optional>

#include "capture/jpeg.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"
#include "parse/json_place.hpp"

namespace manip3d {

/// The calibration of an Azure Kinect as its recordings have it ("CalibrationInformation"), for
/// images of these sizes.
///
/// The lens of its depth camera becomes a ray table, NaN where the calibration does not hold. Of
/// the colour camera's lens (six radial coefficients, three below a fraction line) Brown's five are
/// the nearest over the image in the sense of least squares: off by 0.6 of 1280 x 720 pixels in the
/// corners of a real one. Source: Azure-Kinect-Sensor-SDK,
/// transformation/mode_specific_calibration.c and intrinsic_transformation.c.
/// @throws FormatError  at its place.
std::shared_ptr<RgbdCalibration> azure_calibration(const JsonPlace& place, ImageSize depth,
                                                   const std::optional<ImageSize>& color);

}  // namespace manip3d
