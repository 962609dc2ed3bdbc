#pragma once

#include <memory>

#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// Images of sensors that show the world as a mirror does (the Kinect), turned round on entry.
namespace manip3d {

/// The cameras of the images that `unmirror_images` leaves: cx' = W - 1 - cx, and the rays of a
/// table change places with their pixels, each as it is. A calibration without a mirrored camera is
/// returned itself. Skeletons are not touched.
std::shared_ptr<const RgbdCalibration> unmirrored(
    const std::shared_ptr<const RgbdCalibration>& calibration);

/// Reverses the columns of the images whose camera in `stored` is mirrored, in place.
void unmirror_images(const RgbdCalibration& stored, RgbdFrame& frame);

}  // namespace manip3d
