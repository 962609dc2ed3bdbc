#include <zlib.h>

#include <cstdio>
#include <span>
#include <string>
#include <utility>

#include "capture/image_codec.hpp"
#include "capture/jpeg.hpp"
#include "capture/recording_folder.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Json = JsonPlace::Json;

constexpr const char* kFramesFile = "frames.jsonl";

class FolderRecorder final : public RgbdRecorder {
 public:
  FolderRecorder(const fs::path& folder, const RgbdCalibration& calibration,
                 const RecorderOptions& options)
      : folder_(folder), options_(options), jpeg_(options.jpeg_quality), checks_(calibration) {
    calibration_text_ = calibration_text(calibration);
    lock_ = prepare_folder(folder, layout_, options.overwrite);
    if (fs::is_empty(folder)) begin();  // else the earlier recording is kept until the first frame
  }

  void write(const RgbdFrame& frame) override {
    if (is_closed_) throw InputError("write: the recording is closed");
    RecordingChecks checks = checks_;
    checks.check(frame);
    if (!log_) begin();
    Json line = {{"number", frame.number}, {"time_ns", frame.time_ns}};
    FrameImages images;
    write_images(frame, images, line);
    line["skeletons"] = skeletons_to_json(frame.skeletons);
    log_->append(line.dump() + "\n");
    bytes_ += images.keep();
    checks_ = checks;
    ++frames_;
  }

  void close() override {
    if (std::exchange(is_closed_, true)) return;
    if (log_) log_->close();
    lock_->release();
  }

  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_}, {"bytes", bytes_}};
  }

 private:
  void begin() {
    remove_recording(folder_, layout_);
    write_text(folder_ / kCalibrationFile, calibration_text_);
    log_ = std::make_unique<LineLog>(folder_ / kFramesFile);
  }

  void write_images(const RgbdFrame& frame, FrameImages& images, Json& line) {
    const auto write = [&](const char* kind, const char* suffix, std::span<const std::byte> data) {
      char name[32];
      std::snprintf(name, sizeof(name), "%06lld%s", static_cast<long long>(frames_), suffix);
      images.write(folder_ / kind / name, data);
      line[kind] = {
          {"file", name},
          {"crc32", crc32_z(0, reinterpret_cast<const Bytef*>(data.data()), data.size())}};
    };
    write("depth", ".png", encode_png(frame.depth, frame.cols));
    if (!frame.body_index.empty()) {
      write("body_index", ".png", encode_png(frame.body_index, frame.cols, 1));
    }
    if (frame.color.empty()) return;
    if (options_.lossless_color) {
      write("colour", ".png", encode_png(frame.color, frame.color_cols, 3));
    } else {
      write("colour", ".jpg",
            jpeg_.encode(frame.color.data(), {frame.color_rows, frame.color_cols}));
    }
  }

  const RecordingLayout layout_{{kFramesFile}, {"depth", "body_index", "colour"}};
  fs::path folder_;
  std::string calibration_text_;
  RecorderOptions options_;
  JpegEncoder jpeg_;
  RecordingChecks checks_;
  std::unique_ptr<RecordingLock> lock_;
  std::unique_ptr<LineLog> log_;
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
