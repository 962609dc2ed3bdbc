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

/// Counts of a source or recorder, by name, in the order to be shown: `frames` (given), and
/// what was lost or refused and why.
using Counters = std::vector<std::pair<std::string, std::int64_t>>;

/// Frames of an RGB-D camera. `start` opens the device (files are open from the beginning); after a
/// DeviceError (unplugged) it may be called again. Read frames keep what they own: nothing in them
/// changes later. One thread reads; `stop` may be called by another and ends the wait of `read`.
/// @throws DeviceError  (read, start) the camera is absent or lost.
/// @throws FormatError  (read) a damaged file, by name; the frame's number where it has one.
class RgbdSource : public FrameSource<RgbdFrame> {
 public:
  /// One for all frames; devices know it after `start`.
  [[nodiscard]] virtual std::shared_ptr<const RgbdCalibration> calibration() const = 0;
  [[nodiscard]] virtual Counters counters() const = 0;
  /// How many there are in all; none: nobody knows.
  [[nodiscard]] virtual std::optional<std::int64_t> num_frames() const { return std::nullopt; }
  /// Goes to a frame of a recording, counted from 0: the next `read` gives it, or the next whole
  /// one after it, or kEnd beyond the last. One that plays in real time takes it before `start`
  /// only.
  /// @throws InputError  the source is no recording, or plays in real time already; an index below
  ///                     0.
  virtual void seek(std::int64_t index);
  /// Reads the frame of that index, counted from 0, and no other; the next `read` gives the one
  /// after it.
  /// @throws InputError  as `seek`; the recording has no frame of that index.
  /// @throws FormatError  the frame is damaged or lost.
  virtual void read_at(std::int64_t index, RgbdFrame& frame);
};

/// Check the index of a frame to seek. @throws InputError  below 0.
void check_frame_index(std::int64_t index);

struct RgbdOptions {
  /// Playback speed of recordings; 0: as fast as read, 1: real time, by the frames' times. Frames
  /// that a slow reader misses are counted as `dropped`.
  double speed = 0.0;
  /// For folders of images, which have none of their own; for recordings, instead of their own. A
  /// mirrored camera has its images turned round on entry.
  std::shared_ptr<const RgbdCalibration> calibration;
  /// Unit of the depth images in folders; 0: as the scheme says.
  double units_per_metre = 0.0;
};

/// A kind of source: what it is called, and how to open it or why that cannot be done here.
struct RgbdScheme {
  std::string name;         ///< What stands before the colon of a URI.
  std::string location;     ///< What stands after it, such as `FOLDER`; in brackets if optional.
  std::string description;  ///< One line.
  /// Opens the source of a location; empty where this kind was not built in.
  std::function<std::unique_ptr<RgbdSource>(const std::string& location, const RgbdOptions&)> open;
  std::string reason;  ///< Why it cannot be opened now (not built, no device); empty: it can.
  std::string cure;    ///< What to do about it.
};

/// All kinds, also the absent ones. Looks for devices, which may take a second.
std::vector<RgbdScheme> rgbd_schemes();

/// @throws InputError  an unknown scheme, an option out of range.
/// @throws DeviceError  the scheme is absent (with reason and cure), or there is no such device.
/// @throws FormatError, std::filesystem::filesystem_error  the file.
std::unique_ptr<RgbdSource> open_rgbd(const std::string& uri, const RgbdOptions& options = {});

}  // namespace manip3d
