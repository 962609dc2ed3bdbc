#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <span>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include "capture/image_codec.hpp"
#include "capture/image_frames.hpp"
#include "capture/jpeg.hpp"
#include "capture/recording_lock.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/error.hpp"
#include "manip3d/io/atomic_file.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Json = JsonPlace::Json;

constexpr const char* kCalibrationFile = "calibration.json";
constexpr const char* kFramesFile = "frames.jsonl";
constexpr std::string_view kImageFolders[] = {"depth", "body_index", "colour"};

/// A text file that grows by whole lines.
class LineLog {
 public:
  explicit LineLog(const fs::path& path) : path_(path) {
    descriptor_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor_ < 0) refuse("cannot create");
  }
  LineLog(const LineLog&) = delete;
  LineLog& operator=(const LineLog&) = delete;
  ~LineLog() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }

  void append(const std::string& line) {
    for (std::size_t done = 0; done < line.size();) {
      const ssize_t written = ::write(descriptor_, line.data() + done, line.size() - done);
      if (written < 0 && errno == EINTR) continue;
      if (written < 0) {
        const int reason = errno;
        // What cannot be cut off now stays a line without its end, which readers pass over; more
        // must not be written behind it.
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

  void close() {
    if (descriptor_ < 0) return;
    const int result = ::fsync(descriptor_);
    const int reason = errno;
    ::close(std::exchange(descriptor_, -1));
    errno = reason;
    if (result != 0) refuse("cannot sync");
  }

 private:
  [[noreturn]] void refuse(const char* action) const {
    throw fs::filesystem_error(action, path_, std::error_code(errno, std::generic_category()));
  }

  fs::path path_;
  int descriptor_ = -1;
  off_t size_ = 0;
};

bool holds_recording(const fs::path& folder) {
  return fs::is_regular_file(folder / kCalibrationFile) &&
         fs::is_regular_file(folder / kFramesFile);
}

/// Whether a recorder made everything in the folder, which may have been killed before it began the
/// list of frames. What killed writers leave (.manip3d-XXXXXX) counts as its own.
bool is_replaceable(const fs::path& folder) {
  const bool is_begun = holds_recording(folder);
  return std::ranges::all_of(fs::directory_iterator(folder), [&](const fs::directory_entry& entry) {
    const std::string name = entry.path().filename();
    return name == kCalibrationFile || name.starts_with(".manip3d-") ||
           (is_begun && (name == kFramesFile || std::ranges::count(kImageFolders, name) > 0));
  });
}

/// The list first, so that no frame stands in it whose images are gone. It stays until they are, as
/// the mark of a recording, if this is killed.
void remove_recording(const fs::path& folder) {
  if (holds_recording(folder)) fs::resize_file(folder / kFramesFile, 0);
  for (const std::string_view name : kImageFolders) fs::remove_all(folder / name);
  fs::remove(folder / kFramesFile);
  const std::vector<fs::directory_entry> rest{fs::directory_iterator(folder),
                                              fs::directory_iterator()};
  for (const fs::directory_entry& entry : rest) fs::remove(entry.path());
}

/// Nothing is touched before all is checked.
std::unique_ptr<RecordingLock> prepare_folder(const fs::path& folder, bool overwrite) {
  fs::create_directory(folder);  // a folder that is there is left as it is
  auto lock = std::make_unique<RecordingLock>(folder, RecordingLock::For::kWriting);
  if (fs::is_empty(folder)) return lock;
  if (!overwrite || !is_replaceable(folder)) {
    const char* what = !holds_recording(folder) ? "files"
                       : overwrite              ? "more than a recording"
                                                : "a recording";
    throw InputError("path: expected a new or empty folder, got " + folder.string() +
                     ", which holds " + what);
  }
  remove_recording(folder);
  return lock;
}

std::string calibration_text(const RgbdCalibration& calibration) {
  const Json json = {{"format", "manip3d-rgbd"},
                     {"version", 1},
                     {"calibration", calibration_to_json(calibration)}};
  std::string text = json.dump(1) + "\n";
  if (text.size() > kMaxFolderText) {
    throw InputError("calibration.depth.ray_table: expected at most 48 MiB");
  }
  return text;
}

class FolderRecorder final : public RgbdRecorder {
 public:
  FolderRecorder(const fs::path& folder, const RgbdCalibration& calibration,
                 const RecorderOptions& options)
      : folder_(folder), options_(options), jpeg_(options.jpeg_quality), checks_(calibration) {
    const std::string text = calibration_text(calibration);
    lock_ = prepare_folder(folder, options.overwrite);
    AtomicFile file(folder / kCalibrationFile);
    file.write(text.data(), text.size());
    file.commit();
    log_ = std::make_unique<LineLog>(folder / kFramesFile);
  }

  void write(const RgbdFrame& frame) override {
    if (is_closed_) throw InputError("write: the recording is closed");
    RecordingChecks checks = checks_;
    checks.check(frame);
    Json line = {{"number", frame.number}, {"time_ns", frame.time_ns}};
    written_.clear();
    try {
      write_images(frame, line);
      line["skeletons"] = skeletons_to_json(frame.skeletons);
      log_->append(line.dump() + "\n");
    } catch (...) {
      std::error_code ignored;
      for (const fs::path& path : written_) fs::remove(path, ignored);
      throw;
    }
    checks_ = checks;
    ++frames_;
  }

  void close() override {
    if (std::exchange(is_closed_, true)) return;
    log_->close();
    lock_->release();
  }

  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_}, {"bytes", bytes_}};
  }

 private:
  void write_images(const RgbdFrame& frame, Json& line) {
    line["depth"] = write_image("depth", ".png", encode_png(frame.depth, frame.cols));
    if (!frame.body_index.empty()) {
      line["body_index"] =
          write_image("body_index", ".png", encode_png(frame.body_index, frame.cols, 1));
    }
    if (frame.color.empty()) return;
    line["colour"] =
        options_.lossless_color
            ? write_image("colour", ".png", encode_png(frame.color, frame.color_cols, 3))
            : write_image("colour", ".jpg",
                          jpeg_.encode(frame.color.data(), {frame.color_rows, frame.color_cols}));
  }

  Json write_image(const char* kind, const char* suffix, std::span<const std::byte> data) {
    char name[32];
    std::snprintf(name, sizeof(name), "%06lld%s", static_cast<long long>(frames_), suffix);
    fs::create_directory(folder_ / kind);
    const fs::path path = folder_ / kind / name;
    AtomicFile file(path);
    file.write(reinterpret_cast<const char*>(data.data()), data.size());
    file.commit(false);
    written_.push_back(path);
    bytes_ += std::ssize(data);
    return {{"file", name},
            {"crc32", crc32_z(0, reinterpret_cast<const Bytef*>(data.data()), data.size())}};
  }

  fs::path folder_;
  RecorderOptions options_;
  JpegEncoder jpeg_;
  RecordingChecks checks_;
  std::unique_ptr<RecordingLock> lock_;
  std::unique_ptr<LineLog> log_;
  std::vector<fs::path> written_;  // images of the frame in progress
  std::int64_t frames_ = 0, bytes_ = 0;
  bool is_closed_ = false;
};

}  // namespace

std::unique_ptr<RgbdRecorder> record_folder(const fs::path& folder,
                                            std::shared_ptr<const RgbdCalibration> calibration,
                                            const RecorderOptions& options) {
  return std::make_unique<FolderRecorder>(folder, *calibration, options);
}

}  // namespace manip3d
