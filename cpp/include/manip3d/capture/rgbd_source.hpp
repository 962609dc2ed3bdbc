#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "manip3d/capture/frame_source.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// RGB-D cameras and recordings, opened by a URI such as `folder:walk` or `openni2:`.
namespace manip3d {

/// Named counts of a source or recorder, in the order of display: `frames` (read or written), then
/// losses by cause.
using Counters = std::vector<std::pair<std::string, std::int64_t>>;

/// Differences between the frames of a recording and the content of its files.
struct Conversions {
  /// Images that are stored mirrored, and are mirrored back when they are read.
  bool flipped_depth = false, flipped_color = false;
  double assumed_rate = 0.0;  ///< Frames per second of files without times; 0: they have times.
};

/// Frames of an RGB-D camera or recording. `start` opens a device (files are open from the
/// beginning); it may be called again after a DeviceError (unplugged). Frames that were read do not
/// change later. Only one thread may read; `stop` may be called by another one and ends the wait of
/// `read`.
/// @throws DeviceError  (read, start) the camera is absent or was lost.
/// @throws FormatError  (read) a damaged file, with its name, and with the frame's number if known.
class RgbdSource : public FrameSource<RgbdFrame> {
 public:
  /// The calibration of all frames; devices know it after `start`.
  [[nodiscard]] virtual std::shared_ptr<const RgbdCalibration> calibration() const = 0;
  [[nodiscard]] virtual Counters counters() const = 0;
  /// The conversions of a recording; a camera has none, as nothing else holds its images.
  [[nodiscard]] virtual Conversions conversions() const { return {}; }
  /// Total number of frames; empty: unknown.
  [[nodiscard]] virtual std::optional<std::int64_t> num_frames() const { return std::nullopt; }
  /// Goes to a frame of a recording, counted from 0: the next `read` returns it, or the next intact
  /// frame after it, or kEnd after the last one. A source that plays in real time allows this only
  /// before `start`.
  /// @throws InputError  the source is not a recording, or is playing in real time; a negative
  ///                     index.
  virtual void seek(std::int64_t index);
  /// Reads the frame with this index, counted from 0, and no other one. The next `read` returns the
  /// frame after it, also if this one is damaged or lost.
  /// @throws InputError  as `seek`; the recording has no frame with this index.
  /// @throws FormatError  the frame is damaged or lost.
  virtual void read_at(std::int64_t index, RgbdFrame& frame);
};

/// Checks the index of a frame for seek().
/// @throws InputError  it is negative.
void check_frame_index(std::int64_t index);

struct RgbdOptions {
  /// Playback speed of recordings; 0: as fast as read, 1: real time, by the frames' times. Frames
  /// that a slow reader misses are counted as `dropped`.
  double speed = 0.0;
  /// Camera of folders of images, which have no calibration; for recordings it replaces the stored
  /// one. Images of a mirrored camera are mirrored back when they are read.
  std::shared_ptr<const RgbdCalibration> calibration;
  /// Unit of the depth images in folders; 0: that of the scheme.
  double units_per_metre = 0.0;
  /// Frames per second of folders of images without times; 0: kFolderRate.
  double rate = 0.0;
};

/// A kind of source: its name, and how it is opened or why it cannot be.
struct RgbdScheme {
  std::string name;      ///< Part of the URI before the colon.
  std::string location;  ///< Part after the colon, such as `FOLDER`; in brackets if it is optional.
  std::string description;  ///< One line.
  /// Opens the source at a location; empty if this kind was not built in.
  std::function<std::unique_ptr<RgbdSource>(const std::string& location, const RgbdOptions&)> open;
  std::string reason;  ///< Why it cannot be opened now (not built in, no device); empty: it can.
  std::string cure;    ///< Advice for the user about `reason`.
};

/// Returns all kinds, also those that are not available. It searches for devices, which may take a
/// second.
std::vector<RgbdScheme> rgbd_schemes();

/// Opens the source of a URI.
/// @throws InputError  an unknown scheme, an option out of range.
/// @throws DeviceError  the scheme is not available (with reason and cure), or there is no such
///                      device.
/// @throws FormatError, std::filesystem::filesystem_error  errors of the file.
std::unique_ptr<RgbdSource> open_rgbd(const std::string& uri, const RgbdOptions& options = {});

}  // namespace manip3d
