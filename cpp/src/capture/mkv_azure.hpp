#pragma once

#include <memory>

#include "capture/matroska.hpp"
#include "manip3d/capture/rgbd_source.hpp"

namespace manip3d {

/// Whether the file has the tracks of an Azure Kinect's recorder.
bool is_azure_recording(const MatroskaReader& file);

/// The frames of such a recording: each depth image with the colour image that is nearest in time,
/// within half the time from frame to frame. Infrared images and motion are passed over.
///
/// Counters: `frames`, `without_color`, `damaged`: depth images of another length, JPEG images
/// that cannot be read. There are no hashes: other damage stays unseen.
/// @throws FormatError
std::unique_ptr<RgbdSource> open_azure(std::unique_ptr<MatroskaReader> file,
                                       const RgbdOptions& options);

}  // namespace manip3d
