#include "capture/mkv_azure.hpp"

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <deque>
#include <limits>
#include <string_view>
#include <utility>

#include "capture/azure_calibration.hpp"
#include "capture/mkv_layout.hpp"
#include "capture/raw_color.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"
#include "parse/json_text.hpp"

namespace manip3d {
namespace {

constexpr const char* kDepthTitle = "DEPTH";
constexpr const char* kColorTitle = "COLOR";
constexpr const char* kOffsetTag = "K4A_START_OFFSET_NS";
constexpr std::uint32_t kBigEndianGray = 'b' | '1' << 8 | '6' << 16 | 'g' << 24;
// Microseconds: limit of times, so that the difference of two fits 64 bits in nanoseconds
constexpr std::int64_t kMaxTime = std::int64_t{1} << 51;
// Images at the end of a recording that may be missing although its file is complete
constexpr std::int64_t kLastImages = 2;
constexpr std::size_t kMaxWaiting = 8;  // images of one kind that wait for the other kind
// nanoseconds between frames, for files that do not state it
constexpr std::int64_t kUsualPeriod = 1'000'000'000 / 30;

/// The size of a track's images, checked.
ImageSize checked_size(const MkvTrack& images) {
  const ImageSize size{images.height, images.width};
  if (const std::string reason = mkv::complaint(size); !reason.empty()) {
    throw FormatError(reason, {});
  }
  return size;
}

/// Device time at time 0 of the file, nanoseconds; 0 if the file does not state it.
std::int64_t start_offset_ns(const std::string& text) {
  std::int64_t offset = 0;
  if (text.empty()) return offset;
  const char* end = text.data() + text.size();
  const auto [stopped, error] = std::from_chars(text.data(), end, offset);
  if (error == std::errc() && stopped == end && std::abs(offset / 1000) <= kMaxTime) return offset;
  throw FormatError(
      std::string(kOffsetTag) + ": expected nanoseconds, at most 73 years, got " + text, {});
}

class AzureSource final : public RgbdSource {
 public:
  AzureSource(std::unique_ptr<MatroskaReader> file, const RgbdOptions& options)
      : file_(std::move(file)) {
    open_depth();
    open_color();
    stored_ = options.calibration ? options.calibration : read_calibration();
    calibration_ = unmirrored(stored_);
    if (stored_->depth.height != depth_size_.rows || stored_->depth.width != depth_size_.cols) {
      throw InputError("calibration.depth: expected the size of the recording's depth images, " +
                       std::to_string(depth_size_.cols) + " x " + std::to_string(depth_size_.rows));
    }
    offset_ns_ = start_offset_ns(file_->tag(kOffsetTag));
  }

  [[nodiscard]] SourceCapabilities capabilities() const override { return {}; }
  void start() override {}
  void stop() override { file_->unlock(); }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    return calibration_;
  }
  [[nodiscard]] Conversions conversions() const override { return flips_of(*stored_); }
  [[nodiscard]] Counters counters() const override {
    Counters counters = {
        {"frames", frames_}, {"without_color", without_color_}, {"damaged", damaged_}};
    if (unregistered_color_ > 0) counters.emplace_back("unregistered_color", unregistered_color_);
    if (cut_short_) counters.emplace_back("cut_short", 1);
    return counters;
  }

  ReadStatus read(RgbdFrame& frame, std::chrono::milliseconds) override {
    while (fetch()) {
      const Timed depth = std::move(depths_.front());
      depths_.pop_front();
      const Timed* color = nearest_color(depth.time_ns);
      frame.number = number_++;
      frame.time_ns = depth.time_ns + offset_ns_;
      try {
        fill(frame, depth.bytes, color);
      } catch (const FormatError&) {
        ++damaged_;
        continue;
      }
      without_color_ += color == nullptr ? 1 : 0;
      unregistered_color_ += color != nullptr && !is_color_registered() ? 1 : 0;
      ++frames_;
      return ReadStatus::kFrame;
    }
    const std::int64_t end_ns = 1000 * std::min(file_->duration_us(), kMaxTime);
    cut_short_ = end_ns > 0 && latest_depth_ns_ < end_ns - kLastImages * period_ns_;
    file_->unlock();
    return ReadStatus::kEnd;
  }

  /// These files have no index of frames: frames are skipped from the beginning, without decoding.
  void seek(std::int64_t index) override {
    check_frame_index(index);
    file_->lock();
    if (index < number_) {
      file_ = std::make_unique<MatroskaReader>(file_->path());
      depths_.clear();
      colors_.clear();
      latest_ns_ = std::numeric_limits<std::int64_t>::min();
      number_ = 0;
    }
    for (; number_ < index && fetch(); ++number_) depths_.pop_front();
  }

  void read_at(std::int64_t index, RgbdFrame& frame) override {
    RgbdSource::read_at(index, frame);
    if (frame.number == index) return;
    seek(index + 1);
    throw FormatError("frame " + std::to_string(index) + " is damaged", {})
        .in_file(file_->path().string());
  }

 private:
  struct Timed {
    std::int64_t time_ns;
    std::vector<std::byte> bytes;
  };

  void open_depth() {
    depth_track_ = *file_->find(kDepthTitle, MkvKind::kVideo);
    const MkvTrack& images = file_->track(depth_track_);
    depth_size_ = checked_size(images);
    if (images.four_cc != kBigEndianGray) {
      throw FormatError("DEPTH track: expected images of the kind b16g", {});
    }
    if (images.period_ns > 0) period_ns_ = images.period_ns;
  }

  void open_color() {
    const auto track = file_->find(kColorTitle, MkvKind::kVideo);
    if (!track) return;
    const MkvTrack& images = file_->track(*track);
    raw_color_ = raw_color_of(images.four_cc);
    if (images.format != MkvFormat::kMjpeg && !raw_color_) {
      throw FormatError(
          std::string("COLOR track: expected MJPEG, NV12, YUY2 or BGRA, got ") + images.format_name,
          {});
    }
    color_track_ = *track;
    color_size_ = checked_size(images);
  }

  [[nodiscard]] std::shared_ptr<const RgbdCalibration> read_calibration() const {
    const MkvBytes text = file_->attachment(mkv::kCalibration).data;
    const JsonPlace::Json json =
        parse_json({reinterpret_cast<const char*>(text.data), text.size}, 0);
    return azure_calibration(JsonPlace(json, mkv::kCalibration, 0), depth_size_, color_size_);
  }

  /// Reads packets until the oldest depth image has all colour images that can belong to it.
  bool fetch() {
    const auto is_complete = [&] {
      return !depths_.empty() && (latest_ns_ > depths_.front().time_ns + period_ns_ / 2 ||
                                  depths_.size() > kMaxWaiting);
    };
    while (!is_complete() && file_->next(packet_)) {
      const bool is_depth = packet_.track == depth_track_;
      if (!is_depth && packet_.track != color_track_) continue;
      const std::int64_t time_ns = 1000 * std::clamp(packet_.time_us, -kMaxTime, kMaxTime);
      latest_ns_ = std::max(latest_ns_, time_ns);
      if (is_depth) latest_depth_ns_ = std::max(latest_depth_ns_, time_ns);
      std::deque<Timed>& waiting = is_depth ? depths_ : colors_;
      waiting.push_back({time_ns, std::exchange(packet_.bytes, {})});
      if (colors_.size() > kMaxWaiting) colors_.pop_front();
    }
    return !depths_.empty();
  }

  [[nodiscard]] const Timed* nearest_color(std::int64_t time_ns) const {
    const Timed* nearest = nullptr;
    std::int64_t least = period_ns_ / 2 + 1;
    for (const Timed& color : colors_) {
      const std::int64_t apart = std::abs(color.time_ns - time_ns);
      if (apart >= least) continue;
      least = apart;
      nearest = &color;
    }
    return nearest;
  }

  /// Without a registration, the depth pixels of colours of another size are unknown.
  [[nodiscard]] bool is_color_registered() const {
    return stored_->registration ||
           (color_size_->rows == depth_size_.rows && color_size_->cols == depth_size_.cols);
  }

  void fill(RgbdFrame& frame, const std::vector<std::byte>& depth, const Timed* color) {
    const std::size_t pixels = depth_size_.rows * depth_size_.cols;
    if (depth.size() != 2 * pixels) throw FormatError("damaged", {});
    frame.rows = depth_size_.rows;
    frame.cols = depth_size_.cols;
    frame.depth.resize(pixels);
    for (std::size_t i = 0; i < pixels; ++i) {
      frame.depth[i] = static_cast<std::uint16_t>(std::to_integer<int>(depth[2 * i]) << 8 |
                                                  std::to_integer<int>(depth[2 * i + 1]));
    }
    frame.body_index.clear();
    frame.skeletons.clear();
    frame.color.clear();
    frame.color_rows = frame.color_cols = 0;
    if (color != nullptr && is_color_registered()) {
      frame.color.resize(3 * color_size_->rows * color_size_->cols);
      decode_color(color->bytes, frame.color.data());
      frame.color_rows = color_size_->rows;
      frame.color_cols = color_size_->cols;
    }
    frame.calibration = calibration_;
    unmirror_images(*stored_, frame);
  }

  void decode_color(std::span<const std::byte> image, std::uint8_t* rgb) {
    if (raw_color_) {
      decode_raw_color(*raw_color_, image, *color_size_, rgb);
    } else {
      jpeg_.decode(image, *color_size_, rgb);
    }
  }

  std::unique_ptr<MatroskaReader> file_;
  std::shared_ptr<const RgbdCalibration> stored_, calibration_;
  int depth_track_ = -1, color_track_ = -1;
  ImageSize depth_size_;
  std::optional<ImageSize> color_size_;
  std::int64_t period_ns_ = kUsualPeriod, offset_ns_ = 0;
  JpegDecoder jpeg_;
  std::optional<RawColor> raw_color_;  // empty: MJPEG
  MatroskaPacket packet_;
  std::deque<Timed> depths_, colors_;
  std::int64_t latest_ns_ = std::numeric_limits<std::int64_t>::min();
  std::int64_t latest_depth_ns_ = std::numeric_limits<std::int64_t>::min();
  std::int64_t number_ = 0, frames_ = 0, without_color_ = 0, damaged_ = 0;
  std::int64_t unregistered_color_ = 0;
  bool cut_short_ = false;
};

}  // namespace

bool is_azure_recording(const MatroskaReader& file) {
  return file.find(kDepthTitle, MkvKind::kVideo).has_value();
}

bool is_azure_recording_without_depth(const MatroskaReader& file) {
  return !is_azure_recording(file) && !file.tag(kOffsetTag).empty();
}

std::unique_ptr<RgbdSource> open_azure(std::unique_ptr<MatroskaReader> file,
                                       const RgbdOptions& options) {
  return std::make_unique<AzureSource>(std::move(file), options);
}

}  // namespace manip3d
