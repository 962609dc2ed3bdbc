#pragma once

#include <memory>
#include <optional>

#include "capture/jpeg.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"
#include "parse/json_place.hpp"

namespace manip3d {

/// Converts the calibration of an Azure Kinect in its recordings ("CalibrationInformation") for
/// images of these sizes.
///
/// The lens of the depth camera becomes a ray table, with NaN where the calibration does not hold.
/// The lens of the colour camera (six radial coefficients, three of them in a denominator) is
/// approximated by Brown's five coefficients with least squares over the image: the error is 0.6
/// pixels in the corners of a real 1280 x 720 image. Source: Azure-Kinect-Sensor-SDK,
/// transformation/mode_specific_calibration.c and intrinsic_transformation.c.
/// @throws FormatError  with the place in the file.
std::shared_ptr<RgbdCalibration> azure_calibration(const JsonPlace& place, ImageSize depth,
                                                   const std::optional<ImageSize>& color);

}  // namespace manip3d
