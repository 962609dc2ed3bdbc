#include <algorithm>
#include <cstring>
#include <fstream>
#include <limits>
#include <optional>
#include <utility>

#include "capture/matroska.hpp"
#include "capture/mkv_layout.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;
using Json = JsonPlace::Json;

constexpr std::size_t kMaxAttachment = std::size_t{128} << 20;  // half of what FFmpeg reads

bool is_matroska(const fs::path& path) {
  constexpr char kMagic[] = {'\x1a', '\x45', '\xdf', '\xa3'};  // RFC 8794, section 11.2.1
  char start[sizeof(kMagic)] = {};
  std::ifstream(path, std::ios::binary).read(start, sizeof(start));
  return fs::file_size(path) == 0 || std::memcmp(start, kMagic, sizeof(kMagic)) == 0;
}

void check_target(const fs::path& path, bool overwrite) {
  if (!fs::exists(path)) return;
  if (!overwrite) throw InputError("path: " + path.string() + " exists");
  if (!fs::is_regular_file(path) || !is_matroska(path)) {
    throw InputError("path: expected a recording to replace, got " + path.string());
  }
}

void check_sizes(const RgbdCalibration& calibration) {
  const Intrinsics& depth = calibration.depth;
  const Intrinsics& colour = calibration.registration ? calibration.registration->colour : depth;
  for (const Intrinsics& camera : {depth, colour}) {
    const std::string reason = mkv::complaint({camera.height, camera.width});
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
    file_ = std::make_unique<MatroskaWriter>(path, options.overwrite);
  }

  void write(const RgbdFrame& frame) override {
    if (is_closed_) throw InputError("write: the recording is closed");
    checks_.check(frame);
    if (!is_started_) start(frame);
    const std::int64_t time_ms = container_time(frame.time_ns);
    Json packets = Json::object();
    put(depth_track_, mkv::kDepth, bytes_of(depth_->encode(frame.depth.data())), time_ms, packets);
    if (!frame.body_index.empty()) {
      put(body_track_, mkv::kBodyIndex, bytes_of(body_->encode(frame.body_index.data())), time_ms,
          packets);
    }
    if (!frame.colour.empty()) {
      put(colour_track_, mkv::kColour, encoded_colour(frame), time_ms, packets);
    }
    const Json record = {{"index", frames_},
                         {"number", frame.number},
                         {"time", frame.time_ns},
                         {"packets", std::move(packets)},
                         {"skeletons", skeletons_to_json(frame.skeletons)}};
    std::string text = record.dump();
    text = sha256(std::as_bytes(std::span(text))) + "\n" + text;
    file_->write(frames_track_, std::as_bytes(std::span(text)), time_ms);
    file_->flush();
    ++frames_;
  }

  void close() override {
    if (std::exchange(is_closed_, true)) return;
    if (!is_started_) start_empty();
    file_->finish();
  }

  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_}, {"bytes", file_->size()}};
  }

 private:
  /// Tracks are for what the first frame has (RecordingChecks).
  void start(const RgbdFrame& first) {
    const Intrinsics& depth = calibration_->depth;
    const ImageSize size{depth.height, depth.width};
    depth_.emplace(PixelKind::kGray16, size);
    depth_track_ = file_->add_video(depth_->codec(), mkv::kDepth);
    if (!first.body_index.empty()) {
      body_.emplace(PixelKind::kGray8, size);
      body_track_ = file_->add_video(body_->codec(), mkv::kBodyIndex);
    }
    if (!first.colour.empty()) {
      colour_size_ = {first.colour_rows, first.colour_cols};
      if (options_.lossless_colour) colour_.emplace(PixelKind::kRgb, colour_size_);
      colour_track_ = colour_ ? file_->add_video(colour_->codec(), mkv::kColour)
                              : file_->add_jpeg(colour_size_, mkv::kColour);
    }
    frames_track_ = file_->add_text(mkv::kFrames);
    file_->add_attachment(mkv::kCalibration, sha256(std::as_bytes(std::span(calibration_text_))),
                          calibration_text_);
    file_->start();
    first_time_ = first.time_ns;
    is_started_ = true;
  }

  /// FFmpeg reads no file without a cluster. A record without text is no frame.
  void start_empty() {
    start({});
    const std::string text = sha256({}) + "\n";
    file_->write(frames_track_, std::as_bytes(std::span(text)), 0);
    file_->flush();
  }

  /// Milliseconds since the first frame, no two frames with the same.
  std::int64_t container_time(std::int64_t time_ns) {
    // Times grow, so that the difference fits where int64 would overflow.
    const std::uint64_t since =
        static_cast<std::uint64_t>(time_ns) - static_cast<std::uint64_t>(first_time_);
    const auto rounded = static_cast<std::int64_t>(since / 1000000 + (since % 1000000 >= 500000));
    return last_time_ms_ = std::max(last_time_ms_ + 1, rounded);
  }

  std::span<const std::byte> encoded_colour(const RgbdFrame& frame) {
    return colour_ ? bytes_of(colour_->encode(frame.colour.data()))
                   : jpeg_.encode(frame.colour.data(), colour_size_);
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
  std::optional<Ffv1Encoder> depth_, body_, colour_;
  JpegEncoder jpeg_;
  ImageSize colour_size_;
  int depth_track_ = 0, body_track_ = 0, colour_track_ = 0, frames_track_ = 0;
  std::int64_t first_time_ = 0, last_time_ms_ = -1, frames_ = 0;
  bool is_started_ = false, is_closed_ = false;
};

}  // namespace

std::string mkv_absence() { return ffmpeg_absence(); }

std::unique_ptr<RgbdRecorder> record_mkv(const fs::path& path,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options) {
  return std::make_unique<MkvRecorder>(path, std::move(calibration), options);
}

}  // namespace manip3d
