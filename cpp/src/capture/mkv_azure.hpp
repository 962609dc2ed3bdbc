#pragma once

#include <memory>

#include "capture/matroska.hpp"
#include "manip3d/capture/rgbd_source.hpp"

namespace manip3d {

/// Does the file have the tracks of an Azure Kinect recorder?
bool is_azure_recording(const MatroskaReader& file);

/// Opens such a recording. Each depth image gets the colour image that is nearest in time, within
/// half the time between frames. Infrared images and motion data are ignored.
///
/// Counters: `frames`; `without_color`; `damaged`: depth images of a wrong length, or JPEG images
/// that cannot be read. The files have no hashes, so that other damage is not detected.
/// @throws FormatError
std::unique_ptr<RgbdSource> open_azure(std::unique_ptr<MatroskaReader> file,
                                       const RgbdOptions& options);

}  // namespace manip3d
