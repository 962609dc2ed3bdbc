#pragma once

#include <memory>
#include <string>

#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Cameras that need the libraries of their makers; each is available only if its library was built
/// in. Depth is in millimetres, and the library maps colour to the depth image's pixels.
/// `options.calibration` replaces the camera that the device states.
namespace manip3d {

/// Opens `freenect2:[SERIAL]`, a Kinect V2, with libfreenect2 0.2: 512 x 424 pixels, without lens
/// distortion and not mirrored.
/// @throws DeviceError  (start, read) no such device, unplugged, refused by the library.
std::unique_ptr<RgbdSource> open_freenect2(const std::string& location, const RgbdOptions& options);
/// Reason why no camera can be opened now; empty if there is a camera.
std::string freenect2_absence();

/// Opens `realsense:[SERIAL][?width=848&height=480&rate=30]` or `realsense:FILE.bag`, with
/// librealsense2 2.53 or later. From a recording, all frame sets that the library matches are read
/// (speed 0), or those that a camera would deliver in real time.
/// @throws InputError  an unknown option; (start) a lens model other than Brown's.
/// @throws DeviceError  as open_freenect2(); a file that the library cannot read.
/// @throws std::filesystem::filesystem_error  the file does not exist.
std::unique_ptr<RgbdSource> open_realsense(const std::string& location, const RgbdOptions& options);
std::string realsense_absence();

/// Opens `orbbec:[SERIAL][?width=640&height=576&rate=30]` or `orbbec:FILE.bag`, with OrbbecSDK 2.
/// @throws InputError, DeviceError, std::filesystem::filesystem_error  as open_realsense().
std::unique_ptr<RgbdSource> open_orbbec(const std::string& location, const RgbdOptions& options);
std::string orbbec_absence();

}  // namespace manip3d
