#pragma once

#include <memory>
#include <string>

#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Cameras with OpenNI2 drivers: Kinect V1, Xtion, Structure, Astra. Available only if it was built
/// in.
namespace manip3d {

/// Opens `openni2:` or `openni2:URI`. `openni2:Dummy` is OpenNI2's simulated device, for tests.
///
/// Depth is in OpenNI2's default mode. Colour is read if the device registers depth to colour, so
/// that both have the same pixels. `options.calibration` replaces the camera that follows from the
/// device's field of view; colour then is read without registration as well. If it has a
/// registration, the device's own is switched off, so that colours are not moved twice. Each depth
/// image gets the last colour image, if they are at most 40 ms apart (the counter `without_color`
/// counts the others). Mirroring is switched off, or undone.
/// @throws InputError  (start) the device has no field of view, and no calibration is given.
/// @throws DeviceError  (start, read) no such device, unplugged, refused by the driver.
std::unique_ptr<RgbdSource> open_openni2(const std::string& uri, const RgbdOptions& options);

/// Reason why no camera can be opened now; empty if there is a camera.
std::string openni2_absence();

}  // namespace manip3d
