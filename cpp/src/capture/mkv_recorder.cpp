#include <algorithm>
#include <cstring>
#include <fstream>
#include <limits>
#include <utility>

#include "capture/matroska.hpp"
#include "capture/mkv_layout.hpp"
#include "capture/mkv_library.hpp"
#include "capture/rgbd_json.hpp"
#include "capture/sha256.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Json = JsonPlace::Json;

constexpr std::int64_t kMinSide = 4;  // smallest side of FFV1 images (see MatroskaWriter)
// half of the largest attachment that FFmpeg reads
constexpr std::size_t kMaxAttachment = std::size_t{128} << 20;

bool is_matroska(const fs::path& path) {
  constexpr char kMagic[] = {'\x1a', '\x45', '\xdf', '\xa3'};  // RFC 8794, section 11.2.1
  char start[sizeof(kMagic)] = {};
  std::ifstream(path, std::ios::binary).read(start, sizeof(start));
  return fs::file_size(path) == 0 || std::memcmp(start, kMagic, sizeof(kMagic)) == 0;
}

void check_target(const fs::path& path, bool overwrite) {
  if (!fs::exists(path)) return;
  if (!overwrite) {
    throw InputError("path: " + path.string() +
                     " exists already; --force (overwrite=True) replaces it");
  }
  if (!fs::is_regular_file(path) || !is_matroska(path)) {
    throw InputError("path: expected a recording to replace, got " + path.string());
  }
}

void check_sizes(const RgbdCalibration& calibration) {
  const Intrinsics& depth = calibration.depth;
  const Intrinsics& color = calibration.registration ? calibration.registration->color : depth;
  for (const Intrinsics& camera : {depth, color}) {
    std::string reason = mkv::complaint({camera.height, camera.width});
    if (camera.height < kMinSide || camera.width < kMinSide) {
      reason = "expected at least 4 x 4 pixels for FFV1, got " + std::to_string(camera.width) +
               " x " + std::to_string(camera.height);
    }
    if (!reason.empty()) throw InputError("calibration: " + reason);
  }
}

std::string described(const RgbdCalibration& calibration) {
  std::string text = calibration_to_json(calibration).dump();
  if (text.size() > kMaxAttachment) {
    throw InputError("calibration.depth.ray_table: expected at most 96 MiB");
  }
  return text;
}

class MkvRecorder final : public RgbdRecorder {
 public:
  MkvRecorder(const fs::path& path, std::shared_ptr<const RgbdCalibration> calibration,
              const RecorderOptions& options)
      : calibration_(std::move(calibration)),
        options_(options),
        checks_(*calibration_),
        calibration_text_(described(*calibration_)),
        jpeg_(options.jpeg_quality) {
    check_sizes(*calibration_);
    check_target(path, options.overwrite);
    replaces_ = fs::exists(path) && fs::file_size(path) > 0;
    file_ = std::make_unique<MatroskaWriter>(path, options.overwrite);
  }

  void write(const RgbdFrame& frame) override {
    if (is_closed_) throw InputError("write: the recording is closed");
    checks_.check(frame);
    if (!is_started_) start(frame.time_ns);
    const std::int64_t time_ms = container_time(frame.time_ns);
    Json packets = Json::object();
    put(depth_track_, mkv::kDepth, encoded(depth_track_, frame.depth), time_ms, packets);
    if (!frame.body_index.empty()) {
      put(body_track_, mkv::kBodyIndex, encoded(body_track_, frame.body_index), time_ms, packets);
    }
    if (!frame.color.empty()) {
      put(color_track_, mkv::kColor,
          options_.lossless_color ? encoded(color_track_, frame.color)
                                  : jpeg_.encode(frame.color.data(), color_size_),
          time_ms, packets);
    }
    const Json record = {{"index", frames_},
                         {"number", frame.number},
                         {"time", frame.time_ns},
                         {"packets", std::move(packets)},
                         {"skeletons", skeletons_to_json(frame.skeletons)}};
    write_record(record.dump(), time_ms);
    ++frames_;
  }

  void close() override {
    if (std::exchange(is_closed_, true)) return;
    if (!is_started_ && replaces_) {
      file_->leave();  // no frame came: the earlier recording is kept
      return;
    }
    if (!is_started_) start_empty();
    file_->finish();
  }

  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_}, {"bytes", file_->size()}};
  }

 private:
  /// Adds a track for each kind of image, because the first frames may lack some that come later.
  void start(std::int64_t first_time) {
    const Intrinsics& depth = calibration_->depth;
    const ImageSize size{depth.height, depth.width};
    depth_track_ = add_images(MkvFormat::kFfv1, MkvPixels::kGray16, size, mkv::kDepth);
    body_track_ = add_images(MkvFormat::kFfv1, MkvPixels::kGray8, size, mkv::kBodyIndex);
    const Intrinsics& color =
        calibration_->registration ? calibration_->registration->color : depth;
    color_size_ = {color.height, color.width};
    const auto format = options_.lossless_color ? MkvFormat::kFfv1 : MkvFormat::kMjpeg;
    color_track_ = add_images(format, MkvPixels::kRgb, color_size_, mkv::kColor);
    frames_track_ = file_->add({.kind = MkvKind::kText, .title = mkv::kFrames});
    const std::span calibration = std::as_bytes(std::span(calibration_text_));
    const std::string hash = sha256(calibration);
    file_->add({.kind = MkvKind::kAttachment,
                .data = to_mkv(calibration),
                .title = hash.c_str(),
                .file_name = mkv::kCalibration});
    file_->start();
    first_time_ = first_time;
    is_started_ = true;
  }

  int add_images(MkvFormat format, MkvPixels pixels, ImageSize size, const char* title) {
    return file_->add({.kind = MkvKind::kVideo,
                       .format = format,
                       .pixels = pixels,
                       .width = static_cast<std::int32_t>(size.cols),
                       .height = static_cast<std::int32_t>(size.rows),
                       .title = title});
  }

  /// Writes a record without text, which is not a frame, because FFmpeg reads no file without a
  /// cluster.
  void start_empty() {
    start(0);
    write_record("", 0);
  }

  void write_record(const std::string& json, std::int64_t time_ms) {
    const std::string text = sha256(std::as_bytes(std::span(json))) + "\n" + json;
    file_->write(frames_track_, std::as_bytes(std::span(text)), time_ms);
    file_->flush();
  }

  /// Milliseconds since the first frame; at least one more than for the previous frame.
  std::int64_t container_time(std::int64_t time_ns) {
    // Times grow, so that the unsigned difference is correct even if int64 overflows.
    const std::uint64_t since =
        static_cast<std::uint64_t>(time_ns) - static_cast<std::uint64_t>(first_time_);
    const auto rounded = static_cast<std::int64_t>(since / 1000000 + (since % 1000000 >= 500000));
    return last_time_ms_ = std::max(last_time_ms_ + 1, rounded);
  }

  template <typename Pixels>
  std::span<const std::byte> encoded(int track, const Pixels& image) {
    return file_->encode(track, image.data());
  }

  void put(int track, const char* name, std::span<const std::byte> bytes, std::int64_t time_ms,
           Json& packets) {
    packets[name] = sha256(bytes);
    file_->write(track, bytes, time_ms);
  }

  std::shared_ptr<const RgbdCalibration> calibration_;
  RecorderOptions options_;
  RecordingChecks checks_;
  std::string calibration_text_;
  std::unique_ptr<MatroskaWriter> file_;
  JpegEncoder jpeg_;
  ImageSize color_size_;
  int depth_track_ = 0, body_track_ = 0, color_track_ = 0, frames_track_ = 0;
  std::int64_t first_time_ = 0, last_time_ms_ = -1, frames_ = 0;
  bool replaces_ = false, is_started_ = false, is_closed_ = false;
};

}  // namespace

std::unique_ptr<RgbdRecorder> record_mkv(const fs::path& path,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options) {
  return std::make_unique<MkvRecorder>(path, std::move(calibration), options);
}

}  // namespace manip3d
