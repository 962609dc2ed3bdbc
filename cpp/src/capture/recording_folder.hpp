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
/// Shared parts of the recorders of folders: folders that are theirs, and files that are whole.
namespace manip3d {

inline constexpr const char* kCalibrationFile = "calibration.json";

/// A text file that grows by whole lines.
class LineLog {
 public:
  /// @throws std::filesystem::filesystem_error  it exists, and the like.
  explicit LineLog(const std::filesystem::path& path);
  LineLog(const LineLog&) = delete;
  LineLog& operator=(const LineLog&) = delete;
  ~LineLog();

  /// After an error the file ends with the line before.
  /// @throws std::filesystem::filesystem_error
  void append(const std::string& line);
  /// Syncs and closes the file. Calling it twice does no harm.
  void close();

 private:
  [[noreturn]] void refuse(const char* action) const;

  std::filesystem::path path_;
  int descriptor_ = -1;
  off_t size_ = 0;
};

/// Files and folders that a recorder makes beside calibration.json.
struct RecordingLayout {
  std::vector<std::string_view> lists;  ///< Text files; the first one marks the recording.
  std::vector<std::string_view> image_folders;
};

/// Makes the folder, or takes the one of an earlier recording, which stays as it is until
/// `remove_recording`, and locks it.
/// @throws InputError  the folder holds anything else, or somebody has it open.
std::unique_ptr<RecordingLock> prepare_folder(const std::filesystem::path& folder,
                                              const RecordingLayout& layout, bool overwrite);

/// Empties the folder of a recording. The lists first, so that no frame stands in them whose images
/// are gone. The first one stays until they are, as the mark of a recording, if this is killed.
void remove_recording(const std::filesystem::path& folder, const RecordingLayout& layout);

/// The text of a calibration.json. @throws InputError  too long a ray table.
std::string calibration_text(const RgbdCalibration& calibration);
/// Writes a file, whole or not at all.
void write_text(const std::filesystem::path& path, const std::string& text);

/// The images of one frame; they are removed again unless `keep` is called.
class FrameImages {
 public:
  FrameImages() = default;
  FrameImages(const FrameImages&) = delete;
  FrameImages& operator=(const FrameImages&) = delete;
  ~FrameImages();

  /// @throws std::filesystem::filesystem_error
  void write(const std::filesystem::path& path, std::span<const std::byte> data);
  /// Returns how many bytes they have.
  std::int64_t keep();

 private:
  std::vector<std::filesystem::path> written_;
  std::int64_t bytes_ = 0;
};

}  // namespace manip3d
