#include "capture/recording_folder.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <utility>

#include "capture/image_frames.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/error.hpp"
#include "manip3d/files/atomic_file.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

bool holds_recording(const fs::path& folder, const RecordingLayout& layout) {
  return fs::is_regular_file(folder / kCalibrationFile) &&
         fs::is_regular_file(folder / layout.lists.front());
}

/// Was everything in the folder made by a recorder? It may have been killed before it began the
/// list of frames. Temporary files of killed writers (.manip3d-N) count as made by it.
bool is_replaceable(const fs::path& folder, const RecordingLayout& layout) {
  const bool is_begun = holds_recording(folder, layout);
  return std::ranges::all_of(fs::directory_iterator(folder), [&](const fs::directory_entry& entry) {
    const std::string name = entry.path().filename();
    return name == kCalibrationFile || name.starts_with(".manip3d-") ||
           (is_begun && (std::ranges::count(layout.lists, name) > 0 ||
                         std::ranges::count(layout.image_folders, name) > 0));
  });
}

}  // namespace

LineLog::LineLog(const fs::path& path) : path_(path) {
  descriptor_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (descriptor_ < 0) refuse("cannot create");
}

LineLog::~LineLog() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void LineLog::append(const std::string& line) {
  for (std::size_t done = 0; done < line.size();) {
    const ssize_t written = ::write(descriptor_, line.data() + done, line.size() - done);
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) {
      const int reason = errno;
      // A partial line that cannot be cut off now stays without its end, and readers ignore it.
      // Nothing may be written after it.
      if (::ftruncate(descriptor_, size_) != 0 || ::lseek(descriptor_, size_, SEEK_SET) < 0) {
        ::close(std::exchange(descriptor_, -1));
      }
      errno = reason;
      refuse("cannot write");
    }
    done += static_cast<std::size_t>(written);
  }
  size_ += static_cast<off_t>(line.size());
}

void LineLog::close() {
  if (descriptor_ < 0) return;
  const int result = ::fsync(descriptor_);
  const int reason = errno;
  ::close(std::exchange(descriptor_, -1));
  errno = reason;
  if (result != 0) refuse("cannot sync");
}

void LineLog::refuse(const char* action) const {
  throw fs::filesystem_error(action, path_, std::error_code(errno, std::generic_category()));
}

std::unique_ptr<RecordingLock> prepare_folder(const fs::path& folder, const RecordingLayout& layout,
                                              bool overwrite) {
  fs::create_directory(folder);  // an existing folder stays unchanged
  auto lock = std::make_unique<RecordingLock>(folder, RecordingLock::For::kWriting);
  if (fs::is_empty(folder)) return lock;
  if (!overwrite || !is_replaceable(folder, layout)) {
    const char* what = !holds_recording(folder, layout) ? "files"
                       : overwrite                      ? "more than a recording"
                                                        : "a recording";
    throw InputError("path: expected a new or empty folder, got " + folder.string() +
                     ", which holds " + what);
  }
  return lock;
}

void remove_recording(const fs::path& folder, const RecordingLayout& layout) {
  if (holds_recording(folder, layout)) {
    for (const std::string_view list : layout.lists) {
      if (fs::exists(folder / list)) fs::resize_file(folder / list, 0);
    }
  }
  for (const std::string_view name : layout.image_folders) fs::remove_all(folder / name);
  for (auto list = layout.lists.rbegin(); list != layout.lists.rend(); ++list) {
    fs::remove(folder / *list);
  }
  const std::vector<fs::directory_entry> rest{fs::directory_iterator(folder),
                                              fs::directory_iterator()};
  for (const fs::directory_entry& entry : rest) fs::remove(entry.path());
}

std::string calibration_text(const RgbdCalibration& calibration) {
  const JsonPlace::Json json = {{"format", "manip3d-rgbd"},
                                {"version", 1},
                                {"calibration", calibration_to_json(calibration)}};
  std::string text = json.dump(1) + "\n";
  if (text.size() > kMaxFolderText) {
    throw InputError("calibration.depth.ray_table: expected at most 48 MiB");
  }
  return text;
}

void write_text(const fs::path& path, const std::string& text) {
  AtomicFile file(path);
  file.write(text.data(), text.size());
  file.commit();
}

FrameImages::~FrameImages() {
  std::error_code ignored;
  for (const fs::path& path : written_) fs::remove(path, ignored);
}

void FrameImages::write(const fs::path& path, std::span<const std::byte> data) {
  fs::create_directory(path.parent_path());
  AtomicFile file(path);
  file.write(reinterpret_cast<const char*>(data.data()), data.size());
  file.commit(false);
  written_.push_back(path);
  bytes_ += std::ssize(data);
}

std::int64_t FrameImages::keep() {
  written_.clear();
  return std::exchange(bytes_, 0);
}

}  // namespace manip3d
