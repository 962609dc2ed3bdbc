#pragma once

#include <memory>
#include <string>

#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Cameras by their makers' own libraries, each only where it was built in. Depth in millimetres;
/// colour is brought to the depth image's pixels by the library. `options.calibration` overrules
/// the camera that the device tells.
namespace manip3d {

/// `freenect2:[SERIAL]` Kinect V2 by libfreenect2 0.2: 512 x 424 pixels, the lens's distortion
/// taken out, unmirrored.
/// @throws DeviceError  (start, read) no such device, unplugged, refused by the library.
std::unique_ptr<RgbdSource> open_freenect2(const std::string& location, const RgbdOptions& options);
std::string freenect2_absence();  ///< Why no camera can be opened now; empty: there is one.

/// `realsense:[SERIAL][?width=848&height=480&rate=30]` or `realsense:FILE.bag`, by librealsense2
/// 2.53 or later. Of a recording all that the library brings together come (speed 0), or those that
/// a camera would give.
/// @throws InputError  an unknown option; (start) a lens of another kind than Brown's.
/// @throws DeviceError  as open_freenect2(); a file that the library does not read.
/// @throws std::filesystem::filesystem_error  a file that is not there.
std::unique_ptr<RgbdSource> open_realsense(const std::string& location, const RgbdOptions& options);
std::string realsense_absence();

/// `orbbec:[SERIAL][?width=640&height=576&rate=30]` or `orbbec:FILE.bag`, by OrbbecSDK 2.
/// @throws InputError, DeviceError, std::filesystem::filesystem_error  as open_realsense().
std::unique_ptr<RgbdSource> open_orbbec(const std::string& location, const RgbdOptions& options);
std::string orbbec_absence();

}  // namespace manip3d
