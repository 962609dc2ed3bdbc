#pragma once

#include <memory>

#include "manip3d/capture/rgbd_source.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// Mirrors back the images of sensors that show a mirror image of the world (the Kinect).
namespace manip3d {

/// Returns the calibration of the images after `unmirror_images`: cx' = W - 1 - cx, and the columns
/// of a ray table are reversed without a change of the rays. A calibration without a mirrored
/// camera is returned as it is. Skeletons are not mirrored.
std::shared_ptr<const RgbdCalibration> unmirrored(
    const std::shared_ptr<const RgbdCalibration>& calibration);

/// Returns which images `unmirror_images` reverses.
Conversions flips_of(const RgbdCalibration& stored);

/// Reverses in place the columns of the images whose camera in `stored` is mirrored.
void unmirror_images(const RgbdCalibration& stored, RgbdFrame& frame);

}  // namespace manip3d
