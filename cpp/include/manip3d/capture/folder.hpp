#pragma once

#include <filesystem>
#include <memory>

#include "manip3d/capture/recorder.hpp"
#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Frames in folders of images, which need no library to be read.
///
/// A recording is a folder with
///   calibration.json   {"format": "manip3d-rgbd", "version": 1, "calibration": {...}}
///   frames.jsonl       one line for each frame, in the order of their times
///   depth/             grey PNG of 16 bits, millimetres
///   body_index/        grey PNG of 8 bits, 255: nobody (if the frames have it)
///   colour/            JPEG or PNG (if the frames have it)
/// A line is {"number": N, "time_ns": T, "depth": IMAGE, "body_index": IMAGE, "colour": IMAGE,
/// "skeletons": [...]} with IMAGE {"file": NAME, "crc32": C}; NAME is within the image's folder, C
/// is zlib's sum of the file. A frame's line is written after its images, so a frame without a
/// whole line is not there. src/capture/rgbd_json.hpp tells the rest.
namespace manip3d {

/// `folder:` A recording, or any folder with `depth/*.png` and, if there is colour, `color/`,
/// `colour/` or `rgb/` with as many images, in the order of their names. The latter needs
/// `options.calibration` and has kFolderRate frames a second.
/// @throws FormatError, InputError, std::filesystem::filesystem_error
std::unique_ptr<RgbdSource> open_folder(const std::filesystem::path& folder,
                                        const RgbdOptions& options);

inline constexpr int kFolderRate = 30;  ///< Frames a second where a folder knows no times.

/// `tum:` A sequence of the TUM RGB-D benchmark [Sturm et al., IROS 2012]: depth.txt and rgb.txt
/// list times and files, 5000 units are a metre. Each depth image gets the colour image that is
/// nearest in time, within 0.02 s as the benchmark's own tools do it. Without
/// `options.calibration`: that of the folder's calibration.json; else the camera that the benchmark
/// names for sequences with freiburg1 to 3, or fr1 to 3, in the folder's name; else the one that it
/// names for all (525, 319.5, 239.5), which is counted as `nominal_camera`.
/// @throws FormatError, InputError, std::filesystem::filesystem_error
std::unique_ptr<RgbdSource> open_tum(const std::filesystem::path& folder,
                                     const RgbdOptions& options);

/// A recording as described above. Killed at any moment, it has all frames whose `write` returned;
/// a power failure may take the frames since the last `close`, and the reader then names them.
/// @throws as open_recorder
std::unique_ptr<RgbdRecorder> record_folder(const std::filesystem::path& folder,
                                            std::shared_ptr<const RgbdCalibration> calibration,
                                            const RecorderOptions& options);

/// A sequence as open_tum() and the benchmark's own tools read it: depth/ and rgb/ with an image
/// for each time, named after it, depth.txt, rgb.txt, associations.txt (a line for each frame with
/// colour: time and file of both images) and calibration.json. Colour is PNG. Skeletons, body
/// indices and numbers have no place in it; depths beyond 13.107 m are 0, and counted as `too_far`.
/// @throws as open_recorder; also InputError for a calibration with a registration.
std::unique_ptr<RgbdRecorder> record_tum(const std::filesystem::path& folder,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options);

}  // namespace manip3d
