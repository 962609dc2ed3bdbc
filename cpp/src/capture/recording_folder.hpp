#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "capture/recording_lock.hpp"
#include "manip3d/geometry/rgbd_frame.hpp"

/// @file
/// Common parts of the folder recorders: ownership of folders, and files that are complete.
namespace manip3d {

inline constexpr const char* kCalibrationFile = "calibration.json";

/// A text file that grows by complete lines.
class LineLog {
 public:
  /// @throws std::filesystem::filesystem_error  for example, the file exists.
  explicit LineLog(const std::filesystem::path& path);
  LineLog(const LineLog&) = delete;
  LineLog& operator=(const LineLog&) = delete;
  ~LineLog();

  /// After an error the file ends with the previous line.
  /// @throws std::filesystem::filesystem_error
  void append(const std::string& line);
  /// Syncs and closes the file. A second call has no effect.
  void close();

 private:
  [[noreturn]] void refuse(const char* action) const;

  std::filesystem::path path_;
  int descriptor_ = -1;
  off_t size_ = 0;
};

/// Files and folders that a recorder makes in addition to calibration.json.
struct RecordingLayout {
  std::vector<std::string_view> lists;  ///< Text files; the first one marks the recording.
  std::vector<std::string_view> image_folders;
};

/// Makes the folder, or takes over that of an earlier recording, which is unchanged until
/// `remove_recording`. The folder is locked.
/// @throws InputError  the folder contains other files, or another process has it open.
std::unique_ptr<RecordingLock> prepare_folder(const std::filesystem::path& folder,
                                              const RecordingLayout& layout, bool overwrite);

/// Removes the contents of a recording's folder. The lists are emptied first, so that they name no
/// removed images. The first list is removed last: if this process is killed, it still marks the
/// folder as a recording.
void remove_recording(const std::filesystem::path& folder, const RecordingLayout& layout);

/// The text of a calibration.json.
/// @throws InputError  the ray table is too long.
std::string calibration_text(const RgbdCalibration& calibration);
/// Writes a file completely or not at all.
void write_text(const std::filesystem::path& path, const std::string& text);

/// The images of one frame. They are removed by the destructor unless `keep` was called.
class FrameImages {
 public:
  FrameImages() = default;
  FrameImages(const FrameImages&) = delete;
  FrameImages& operator=(const FrameImages&) = delete;
  ~FrameImages();

  /// @throws std::filesystem::filesystem_error
  void write(const std::filesystem::path& path, std::span<const std::byte> data);
  /// Keeps the images; returns their bytes.
  std::int64_t keep();

 private:
  std::vector<std::filesystem::path> written_;
  std::int64_t bytes_ = 0;
};

}  // namespace manip3d
