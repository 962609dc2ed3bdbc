#pragma once

#include <memory>
#include <string>

#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Cameras that OpenNI2 drives: Kinect V1, Xtion, Structure, Astra. Only where it was built in.
namespace manip3d {

/// `openni2:` or `openni2:URI`; `openni2:Dummy` is a device that OpenNI2 makes up, for tests.
///
/// Depth in OpenNI2's default mode. Colour where the device registers depth to colour, so that both
/// have the same pixels; `options.calibration` overrules what the device says about its field of
/// view, and then colour comes as it is. Each depth image has the colour image that came last, if
/// they are at most 40 ms apart (`without_color` counts the others). Mirroring is switched off, or
/// undone.
/// @throws InputError  (start) the device tells no field of view, and there is no calibration.
/// @throws DeviceError  (start, read) no such device, unplugged, refused by the driver.
std::unique_ptr<RgbdSource> open_openni2(const std::string& uri, const RgbdOptions& options);

/// Why no camera can be opened now; empty: there is one.
std::string openni2_absence();

}  // namespace manip3d
