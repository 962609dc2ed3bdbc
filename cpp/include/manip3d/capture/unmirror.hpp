#pragma once

#include <memory>

#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// Images of sensors that show the world as a mirror does (the Kinect), turned round on entry.
namespace manip3d {

/// The same cameras looking at images that are turned round: cx' = W - 1 - cx. A ray table's rows
/// are reversed with the images'; the directions in it stay. Skeletons have nothing to do with it.
std::shared_ptr<const RgbdCalibration> unmirrored(
    const std::shared_ptr<const RgbdCalibration>& calibration);

/// Reverses the columns of the images whose camera in `stored` is mirrored, in place.
void unmirror_images(const RgbdCalibration& stored, RgbdFrame& frame);

}  // namespace manip3d
