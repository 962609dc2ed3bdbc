#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <cerrno>
#include <cstdio>
#include <span>
#include <string>
#include <system_error>
#include <utility>

#include "capture/image_codec.hpp"
#include "capture/jpeg.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/error.hpp"
#include "manip3d/io/atomic_file.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Json = JsonPlace::Json;

constexpr const char* kImageFolders[] = {"depth", "body_index", "colour"};

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

bool is_recording(const fs::path& folder) {
  return fs::exists(folder / "calibration.json") && fs::exists(folder / "frames.jsonl");
}

/// Frames first, so that nothing stands in the list whose image is gone.
void remove_recording(const fs::path& folder) {
  fs::remove(folder / "frames.jsonl");
  for (const char* name : kImageFolders) fs::remove_all(folder / name);
  fs::remove(folder / "calibration.json");
}

void prepare_folder(const fs::path& folder, bool overwrite) {
  fs::create_directory(folder);  // a folder that is there is left as it is
  if (overwrite && is_recording(folder)) remove_recording(folder);
  if (!fs::is_empty(folder)) {
    throw InputError("path: expected a new or empty folder, got " + folder.string() +
                     (is_recording(folder) ? ", which holds a recording" : ", which holds files"));
  }
}

void write_text(const fs::path& path, const std::string& text) {
  AtomicFile file(path);
  file.write(text.data(), text.size());
  file.commit();
}

class FolderRecorder final : public RgbdRecorder {
 public:
  FolderRecorder(const fs::path& folder, const RgbdCalibration& calibration,
                 const RecorderOptions& options)
      : folder_(folder), options_(options), jpeg_(options.jpeg_quality), checks_(calibration) {
    prepare_folder(folder, options.overwrite);
    const Json described = {{"format", "manip3d-rgbd"},
                            {"version", 1},
                            {"calibration", calibration_to_json(calibration)}};
    write_text(folder / "calibration.json", described.dump(1) + "\n");
    log_ = std::make_unique<LineLog>(folder / "frames.jsonl");
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
    if (frame.colour.empty()) return;
    line["colour"] =
        options_.lossless_colour
            ? write_image("colour", ".png", encode_png(frame.colour, frame.colour_cols, 3))
            : write_image(
                  "colour", ".jpg",
                  jpeg_.encode(frame.colour.data(), {frame.colour_rows, frame.colour_cols}));
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
