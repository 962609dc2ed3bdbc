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
/// A frame is its images, at the same time in milliseconds, and after them its record:
/// - `depth`: FFV1, 16-bit grey, millimetres; `body index`: FFV1, 8-bit grey;
/// - `color`: JPEG as MJPEG, or FFV1, RGB;
/// - `frames`: text (S_TEXT/UTF8): 64 digits, the SHA-256 of the JSON text in the next line, which
///   has {"index", "number", "time", "packets", "skeletons"}: `index` counts the frames of the file
///   from 0, `time` is exact, in nanoseconds, and `packets` has the SHA-256 of each image's packet;
/// - `calibration.json`, attached, its SHA-256 in its description.
/// Tracks are known by their titles. FFV1's slices have CRCs of their own, for other programs.
namespace manip3d {

/// The library of codec and muxer (mkv_codec.hpp), or why there is none and what to do about it.
struct FoundMkvCodec {
  const MkvCodec* codec = nullptr;
  std::string reason, cure;
};
using MkvLoader = FoundMkvCodec (*)();

/// Sets the function that finds the codec library. It is called when the library is first needed,
/// and again until it has found one.
void set_mkv_loader(MkvLoader load);
/// The library, if it is of this version and complete.
FoundMkvCodec find_mkv_codec();

/// Records depth, body index, skeletons and times exactly, colour as JPEG or exactly. Each frame is
/// handed to the operating system before `write` returns: a killed process loses the frame in
/// progress. When the disk is full, the file ends after the last whole frame.
/// @throws DeviceError  find_mkv_codec() has none.
/// @throws InputError  the path exists and is not a Matroska file, or is not to be overwritten; a
/// calibration out of range.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<RgbdRecorder> record_mkv(const std::filesystem::path& path,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options = {});

/// Reads what record_mkv() wrote, as far as it came, and recordings of the Azure Kinect.
///
/// Counters of own recordings: `frames`; `damaged`: frames of which a packet is missing or other
/// than was written; `lost`: frames without a trace but the gap; `cut_short`: 1 if frames are
/// missing at the end; `unfinished`: 1 if the recorder was stopped before `close`.
/// @throws DeviceError  find_mkv_codec() has none.
/// @throws FormatError  no such recording, or damaged where it says what is in it.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<RgbdSource> open_mkv(const std::filesystem::path& path,
                                     const RgbdOptions& options = {});

}  // namespace manip3d
