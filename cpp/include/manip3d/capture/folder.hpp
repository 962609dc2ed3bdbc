#pragma once

#include <filesystem>
#include <memory>

#include "manip3d/capture/recorder.hpp"
#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Frames in folders of images; no optional library is needed to read these.
///
/// A recording is a folder with
///   calibration.json   {"format": "manip3d-rgbd", "version": 1, "calibration": {...}}
///   frames.jsonl       one line per frame, in order of time
///   depth/             grey PNG of 16 bits, millimetres
///   body_index/        grey PNG of 8 bits, 255: background (only if the frames have it)
///   colour/            JPEG or PNG (only if the frames have it)
/// A line is {"number": N, "time_ns": T, "depth": IMAGE, "body_index": IMAGE, "colour": IMAGE,
/// "skeletons": [...]} with IMAGE {"file": NAME, "crc32": C}; NAME is within the image's folder, C
/// is zlib's CRC-32 of the file. The line of a frame is written after its images, so that a frame
/// without a complete line does not count. The JSON formats of calibration and skeletons are
/// described in src/capture/rgbd_json.hpp.
namespace manip3d {

/// Opens `folder:`, a recording, or any folder with `depth/*.png` and optionally colour images in
/// `color/`, `colour/`, `rgb/`, `image/` or `images/`, in the order of their names. Other files
/// in `depth/` are left out. A folder that is not a recording needs a calibration
/// (`options.calibration`, or calibration.json). The counter `depth_of_8_bits` counts frames whose
/// depth has 8 bits.
///
/// If the names of depth images are times (in seconds with a fraction, or with so many digits that
/// they count milliseconds or less since 1970), these are the times of the frames, and colour
/// images whose names are times are paired with them as in open_tum(), at least one of them (see
/// has_decimals() in src/capture/image_names.hpp for names such as 1.10). Otherwise there are no
/// times: frames are evenly spaced, `options.rate` a second (0: kFolderRate), with gaps in their
/// times and numbers where frame numbers are missing. Colour images are then paired by the numbers
/// in the names, or in order if no numbers agree (see pair_by_name() in
/// src/capture/image_names.hpp). The counter `without_color` counts depth images without a colour
/// image if there are colour images at all; colour images without a depth image are left out.
/// @throws InputError  options.rate is given for frames that have times; no calibration is known.
/// @throws FormatError  it is not known which images belong together.
std::unique_ptr<RgbdSource> open_folder(const std::filesystem::path& folder,
                                        const RgbdOptions& options);

inline constexpr int kFolderRate = 30;  ///< Frames per second of folders without times.

/// Opens `tum:`, a sequence of the TUM RGB-D benchmark [Sturm et al., IROS 2012]. depth.txt and
/// rgb.txt (or color.txt) list times and files, separated by blanks and tabs, or by commas if one
/// follows the time; a sequence without colour has neither. 5000 depth units are a metre unless
/// `options.units_per_metre` states another number. Depth and colour
/// images within 0.02 s are paired, each in one pair at most: as many as possible, and of these
/// pairings the one with the least sum of differences. The counter `without_color` counts depth
/// images without a colour image. If a list ends within a line, this line is left out, and the
/// counter `incomplete` is 1.
///
/// The camera is `options.calibration` if given, else that of the folder's calibration.json.
/// Without both, the folder's name decides: with freiburg1 to 3 or fr1 to 3 in it, the camera is
/// the one that the benchmark publishes for these sequences; otherwise it is the benchmark's common
/// camera (f = 525, cx = 319.5, cy = 239.5), and the counter `nominal_camera` is 1.
/// @throws FormatError, InputError, std::filesystem::filesystem_error
std::unique_ptr<RgbdSource> open_tum(const std::filesystem::path& folder,
                                     const RgbdOptions& options);

/// Starts a recording as described above. If the process is killed, all frames whose `write` has
/// returned can be read. A power failure may lose the frames since the last `close`; the reader
/// then names them.
/// @throws  see open_recorder().
std::unique_ptr<RgbdRecorder> record_folder(const std::filesystem::path& folder,
                                            std::shared_ptr<const RgbdCalibration> calibration,
                                            const RecorderOptions& options);

/// Starts a sequence that open_tum() and the benchmark's own tools can read: depth/ and rgb/ with
/// an image per time, named after it; depth.txt, rgb.txt, and associations.txt (one line per frame
/// with colour: time and file of both images); and calibration.json. Colour is PNG. Skeletons, body
/// indices and frame numbers are not stored. Depths beyond 13.106 m are written as 0 and counted as
/// `too_far`.
/// @throws  see open_recorder(); also InputError for a calibration with a registration.
std::unique_ptr<RgbdRecorder> record_tum(const std::filesystem::path& folder,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options);

}  // namespace manip3d
