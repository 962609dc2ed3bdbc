#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "manip3d/capture/mkv_codec.hpp"
#include "manip3d/capture/recorder.hpp"
#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// RGB-D recordings in Matroska.
///
/// A frame consists of its images, all at the same time in milliseconds, followed by its record:
/// - `depth`: FFV1, 16-bit grey, millimetres; `body index`: FFV1, 8-bit grey;
/// - `color`: JPEG as MJPEG, or FFV1, RGB;
/// - `frames`: text (S_TEXT/UTF8): the SHA-256 of the JSON text in 64 digits, then the JSON text in
///   the next line: {"index", "number", "time", "packets", "skeletons"}. `index` counts the frames
///   of the file from 0, `time` is exact in nanoseconds, and `packets` has the SHA-256 of each
///   image's packet;
/// - `calibration.json`: an attachment with its SHA-256 as the description.
/// Tracks are identified by their titles. FFV1's slices have CRCs as well, for other programs.
namespace manip3d {

/// The library of codec and muxer (mkv_codec.hpp), or the reason why there is none, with a cure.
struct FoundMkvCodec {
  const MkvCodec* codec = nullptr;
  std::string reason, cure;
};
using MkvLoader = FoundMkvCodec (*)();

/// Sets the function that finds the codec library. It is called when the library is first needed,
/// and again each time until it has found one.
void set_mkv_loader(MkvLoader load);
/// Finds the library; it must be complete and of this version.
FoundMkvCodec find_mkv_codec();

/// Starts a recording. Depth, body index, skeletons and times are exact, colour is JPEG or exact.
/// Each frame is handed to the operating system before `write` returns, so that a killed process
/// loses only the frame in progress. If the disk is full, the file ends after the last complete
/// frame.
/// @throws DeviceError  find_mkv_codec() finds no library.
/// @throws InputError  the path exists and is not a Matroska file, or must not be overwritten; a
///                     calibration out of range.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<RgbdRecorder> record_mkv(const std::filesystem::path& path,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options = {});

/// Opens a recording of record_mkv(), also an unfinished one, or one of the Azure Kinect.
///
/// Counters of recordings of record_mkv(): `frames`; `damaged`: frames with a missing or changed
/// packet; `lost`: frames of which only a gap in the indices is left; `cut_short`: 1 if frames are
/// missing at the end; `unfinished`: 1 if the recorder was stopped before `close`.
/// @throws DeviceError  find_mkv_codec() finds no library.
/// @throws FormatError  no such recording, or one with damaged headers.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<RgbdSource> open_mkv(const std::filesystem::path& path,
                                     const RgbdOptions& options = {});

}  // namespace manip3d
