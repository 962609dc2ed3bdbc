#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>

#include "manip3d/capture/rgbd_source.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// Recordings of RGB-D frames as they are made.
namespace manip3d {

/// Writes frames in the order of their times. What was written can be read back after the process
/// is killed, but for the last frames (each format says how many); a frame is there whole or not
/// at all. After an error the frames before are good, and `close` may still be called.
class RgbdRecorder {
 public:
  RgbdRecorder() = default;
  RgbdRecorder(const RgbdRecorder&) = delete;
  RgbdRecorder& operator=(const RgbdRecorder&) = delete;
  virtual ~RgbdRecorder() = default;  ///< Without `close`, what a killed process leaves.

  /// @throws InputError  images that do not fit each other or the calibration, a time or number
  /// that does not grow, an image that the first frame did not have; nothing is written.
  /// @throws std::filesystem::filesystem_error  the disk is full, and the like.
  virtual void write(const RgbdFrame& frame) = 0;
  /// Finishes and syncs the recording; `write` is over. Calling it twice does no harm.
  virtual void close() = 0;
  [[nodiscard]] virtual Counters counters() const = 0;
};

enum class RecordingKind : std::uint8_t { kFolder, kMkv, kTum };

struct RecorderOptions {
  std::optional<RecordingKind> kind{};  ///< None: Matroska for `.mkv`, else a folder.
  bool lossless_color = false;          ///< Instead of JPEG.
  int jpeg_quality = 90;                ///< 1 to 100.
  bool overwrite = false;               ///< Replace a recording of the same kind that is there.
};

/// Starts a recording.
/// @throws InputError  an unknown suffix, a path that exists or that somebody has open, an option
/// or calibration out of range.
/// @throws DeviceError  the codec library of Matroska is absent.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<RgbdRecorder> open_recorder(const std::filesystem::path& path,
                                            std::shared_ptr<const RgbdCalibration> calibration,
                                            const RecorderOptions& options = {});

inline constexpr std::size_t kMaxSkeletons = 64;  ///< Most of a recorded frame; sensors track six.

/// Checks that every recorder makes of its frames before it writes them.
class RecordingChecks {
 public:
  /// @throws InputError  a calibration out of range.
  explicit RecordingChecks(const RgbdCalibration& calibration);
  /// @throws InputError  as RgbdRecorder::write; the frame then counts as never seen.
  void check(const RgbdFrame& frame);

 private:
  std::int64_t rows_ = 0, cols_ = 0, color_rows_ = 0, color_cols_ = 0;
  std::int64_t number_ = 0, time_ns_ = 0;  // of the frame before
  bool is_first_ = true, has_body_index_ = false, has_color_ = false;
};

}  // namespace manip3d
