#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>

#include "manip3d/capture/rgbd_source.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// Recorders of RGB-D frames.
namespace manip3d {

/// Writes frames in order of time. If the process is killed, all but the last frames can be read
/// (each format says how many are lost); no frame is read in part. After an error, the frames
/// before it are intact, and `close` may still be called.
class RgbdRecorder {
 public:
  RgbdRecorder() = default;
  RgbdRecorder(const RgbdRecorder&) = delete;
  RgbdRecorder& operator=(const RgbdRecorder&) = delete;
  virtual ~RgbdRecorder() = default;  ///< Without `close`: the same as a killed process.

  /// @throws InputError  images that do not fit each other or the calibration, or a time or number
  ///                     that does not grow; nothing is written then.
  /// @throws std::filesystem::filesystem_error  for example, the disk is full.
  virtual void write(const RgbdFrame& frame) = 0;
  /// Finishes and syncs the recording; `write` must not be called afterwards. A second call has no
  /// effect.
  virtual void close() = 0;
  [[nodiscard]] virtual Counters counters() const = 0;
};

enum class RecordingKind : std::uint8_t { kFolder, kMkv, kTum };

struct RecorderOptions {
  std::optional<RecordingKind> kind{};  ///< Empty: Matroska for `.mkv`, else a folder.
  bool lossless_color = false;          ///< Store colour exactly instead of as JPEG.
  int jpeg_quality = 90;                ///< 1 to 100.
  bool overwrite = false;               ///< Replace an existing recording of the same kind.
};

/// Starts a recording.
/// @throws InputError  an unknown suffix, a path that exists or that another process has open, an
///                     option or calibration out of range.
/// @throws DeviceError  the codec library for Matroska is not available.
/// @throws std::filesystem::filesystem_error  the operating system refused.
std::unique_ptr<RgbdRecorder> open_recorder(const std::filesystem::path& path,
                                            std::shared_ptr<const RgbdCalibration> calibration,
                                            const RecorderOptions& options = {});

/// Largest number in a recorded frame; sensors track six.
inline constexpr std::size_t kMaxSkeletons = 64;

/// Checks that each recorder applies to a frame before it writes it.
class RecordingChecks {
 public:
  /// @throws InputError  a calibration out of range.
  explicit RecordingChecks(const RgbdCalibration& calibration);
  /// @throws InputError  as RgbdRecorder::write; the frame then does not change the state.
  void check(const RgbdFrame& frame);

 private:
  std::int64_t rows_ = 0, cols_ = 0, color_rows_ = 0, color_cols_ = 0;
  std::int64_t number_ = 0, time_ns_ = 0;  // of the previous frame
  bool is_first_ = true;
};

}  // namespace manip3d
