#pragma once

#include <memory>

#include "capture/matroska.hpp"
#include "manip3d/capture/rgbd_source.hpp"

namespace manip3d {

/// Does the file have the tracks of an Azure Kinect recorder?
bool is_azure_recording(const MatroskaReader& file);

/// Is it a recording of an Azure Kinect without depth images, as in the modes "passive infrared"
/// and "off"?
bool is_azure_recording_without_depth(const MatroskaReader& file);

/// Opens such a recording. Each depth image gets the colour image that is nearest in time, within
/// half the time between frames. Infrared images and motion data are ignored.
///
/// Counters: `frames`; `without_color`; `damaged`: depth images or uncompressed colour images of a
/// wrong length, or JPEG images that cannot be read; `cut_short`: 1 if the last images are missing.
/// The files have no hashes, so that other damage is not detected.
/// @throws FormatError
std::unique_ptr<RgbdSource> open_azure(std::unique_ptr<MatroskaReader> file,
                                       const RgbdOptions& options);

}  // namespace manip3d
