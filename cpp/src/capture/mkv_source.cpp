#include <algorithm>
#include <array>
#include <optional>
#include <string_view>
#include <utility>

#include "capture/matroska.hpp"
#include "capture/mkv_azure.hpp"
#include "capture/mkv_layout.hpp"
#include "capture/rgbd_json.hpp"
#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"
#include "parse/json_text.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxRecordBytes = 1 << 20;  // 64 skeletons take 300 kB

[[noreturn]] void refuse_track(const char* name, const std::string& reason) {
  throw FormatError(std::string(name) + " track: " + reason, {});
}

std::string_view text_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// A track of images: its decoder, and the packet that came last.
class ImageTrack {
 public:
  ImageTrack(const char* name, int stream, const AVCodecParameters& parameters, PixelKind kind,
             ImageSize size)
      : name_(name), stream_(stream), size_(size), packet_(new_packet()) {
    if (const std::string reason = mkv::complaint(size); !reason.empty()) {
      refuse_track(name, reason);
    }
    if (kind == PixelKind::kRgb && parameters.codec_id == AV_CODEC_ID_MJPEG) {
      jpeg_ = std::make_unique<JpegDecoder>();  // each packet says its size
      return;
    }
    try {
      ffv1_.emplace(parameters, kind, size);
    } catch (const FormatError& error) {
      refuse_track(name, error.reason());
    }
  }

  [[nodiscard]] int stream() const { return stream_; }
  [[nodiscard]] const char* name() const { return name_; }
  [[nodiscard]] ImageSize size() const { return size_; }
  [[nodiscard]] bool has_packet() const { return packet_->size > 0; }

  /// Takes over the packet; the one before is gone.
  void take(PacketPtr& packet) { std::swap(packet_, packet); }
  void drop() { ffmpeg().av_packet_unref(packet_.get()); }

  /// The pixels of the packet that came last, if it is the one of this time and hash.
  /// @throws FormatError
  template <typename T>
  void decode(std::int64_t time_ms, const std::string& hash, std::size_t channels,
              std::vector<T>& pixels) {
    if (!has_packet() || packet_->pts != time_ms) throw FormatError("packet missing", {});
    if (sha256(bytes_of(*packet_)) != hash) throw FormatError("packet damaged", {});
    pixels.resize(static_cast<std::size_t>(size_.rows * size_.cols) * channels);
    if (jpeg_) {
      jpeg_->decode(bytes_of(*packet_), size_, reinterpret_cast<std::uint8_t*>(pixels.data()));
    } else {
      ffv1_->decode(*packet_, pixels.data());
    }
  }

 private:
  const char* name_;
  int stream_;
  ImageSize size_;
  PacketPtr packet_;
  std::optional<Ffv1Decoder> ffv1_;
  std::unique_ptr<JpegDecoder> jpeg_;
};

/// The attached calibration, if it is the one that was written.
std::shared_ptr<const RgbdCalibration> read_calibration(const MatroskaReader& file) {
  const MatroskaReader::Attachment attached = file.attachment(mkv::kCalibration);
  if (sha256(std::as_bytes(std::span(attached.text))) != attached.description) {
    throw FormatError("calibration.json: damaged: its hash is another", {});
  }
  const JsonPlace::Json json = parse_json(attached.text, 0);
  const JsonPlace place(json, mkv::kCalibration, 0);
  return calibration_from_json(place);
}

/// @throws FormatError  a record that is not the one that was written.
JsonPlace::Json checked_record(const AVPacket& packet) {
  if (packet.size > kMaxRecordBytes) throw FormatError("record too long", {});
  const std::string_view text = text_of(bytes_of(packet));
  const std::string_view hash = text.substr(0, mkv::kHashDigits);
  const std::string_view json = text.substr(std::min(text.size(), mkv::kHashDigits + 1));
  if (sha256(std::as_bytes(std::span(json))) != hash) throw FormatError("record damaged", {});
  return parse_json(json, 0);
}

std::int64_t index_of(const JsonPlace& record, std::int64_t least) {
  return record.member("index").integer(least, std::numeric_limits<std::int64_t>::max() - 1);
}

/// One more than the index of the last record; none where the file was not finished, or its end is
/// cut off or damaged.
std::optional<std::int64_t> count_frames(const fs::path& path) try {
  MatroskaReader file(path);
  const auto depth = file.find(mkv::kDepth, AVMEDIA_TYPE_VIDEO);
  const auto frames = file.find(mkv::kFrames, AVMEDIA_TYPE_SUBTITLE);
  if (file.duration_ms() == 0 || !depth || !frames || !file.seek_last(*depth)) return std::nullopt;
  std::optional<std::int64_t> count;
  for (PacketPtr packet = new_packet(); file.next(*packet);) {
    if (packet->stream_index != *frames || packet->pts + 1 < file.duration_ms()) continue;
    const JsonPlace::Json json = checked_record(*packet);
    count = index_of(JsonPlace(json, mkv::kFrames, 0), 0) + 1;
  }
  return count;
} catch (const FormatError&) {
  return std::nullopt;
}

class MkvSource final : public RgbdSource {
 public:
  MkvSource(std::unique_ptr<MatroskaReader> file, const RgbdOptions& options,
            std::optional<std::int64_t> num_frames)
      : file_(std::move(file)), num_frames_(num_frames) {
    stored_ = options.calibration ? options.calibration : read_calibration(*file_);
    calibration_ = unmirrored(stored_);
    const Intrinsics& depth = calibration_->depth;
    const Intrinsics& colour =
        calibration_->registration ? calibration_->registration->colour : depth;
    add_track(mkv::kDepth, PixelKind::kGray16, {depth.height, depth.width}, depth_);
    add_track(mkv::kBodyIndex, PixelKind::kGray8, {depth.height, depth.width}, body_index_);
    add_track(mkv::kColour, PixelKind::kRgb, {colour.height, colour.width}, colour_);
    const auto frames = file_->find(mkv::kFrames, AVMEDIA_TYPE_SUBTITLE);
    if (!depth_ || !frames) throw FormatError("expected the tracks 'depth' and 'frames'", {});
    frames_track_ = *frames;
  }

  [[nodiscard]] SourceCapabilities capabilities() const override { return {}; }
  void start() override {}
  void stop() override {}
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    return calibration_;
  }
  [[nodiscard]] std::optional<std::int64_t> num_frames() const override { return num_frames_; }
  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_},
            {"damaged", damaged_},
            {"lost", lost_},
            {"cut_short", cut_short_ ? 1 : 0},
            {"unfinished", file_->duration_ms() > 0 ? 0 : 1}};
  }

  ReadStatus read(RgbdFrame& frame, std::chrono::milliseconds) override {
    while (file_->next(*packet_)) {
      if (packet_->stream_index != frames_track_) {
        keep_image();
      } else if (read_frame(frame)) {
        ++frames_;
        return ReadStatus::kFrame;
      }
    }
    // Images without their record are the frame in progress when the recorder was killed.
    for (const auto* track : {&depth_, &body_index_, &colour_}) {
      cut_short_ = cut_short_ || (*track && (*track)->has_packet());
    }
    cut_short_ = cut_short_ || last_time_ms_ + 1 < file_->duration_ms();
    return ReadStatus::kEnd;
  }

 private:
  void add_track(const char* name, PixelKind kind, ImageSize size,
                 std::optional<ImageTrack>& track) {
    if (const auto index = file_->find(name, AVMEDIA_TYPE_VIDEO)) {
      track.emplace(name, *index, file_->parameters(*index), kind, size);
    }
  }

  void keep_image() {
    for (auto* track : {&depth_, &body_index_, &colour_}) {
      if (*track && (*track)->stream() == packet_->stream_index) (*track)->take(packet_);
    }
  }

  /// The frame whose record has just come; false if it is not whole. A record that is damaged
  /// itself shows as a gap before the next one.
  bool read_frame(RgbdFrame& frame) {
    bool is_known = false;  // the record can be believed, and the frame counted
    try {
      const JsonPlace::Json json = checked_record(*packet_);
      const JsonPlace record(json, mkv::kFrames, 0);
      const std::int64_t index = index_of(record, next_index_);
      lost_ += index - std::exchange(next_index_, index + 1);
      last_time_ms_ = packet_->pts;
      is_known = true;
      fill(record, frame);
      drop_images();
      return true;
    } catch (const FormatError&) {
      damaged_ += is_known ? 1 : 0;
    }
    drop_images();
    return false;
  }

  void drop_images() {
    for (auto* track : {&depth_, &body_index_, &colour_}) {
      if (*track) (*track)->drop();
    }
  }

  void fill(const JsonPlace& record, RgbdFrame& frame) {
    constexpr std::int64_t kLeast = std::numeric_limits<std::int64_t>::min();
    constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
    frame.number = record.member("number").integer(kLeast, kMost);
    frame.time_ns = record.member("time").integer(kLeast, kMost);
    const JsonPlace packets = record.member("packets");
    if (!packets.has(mkv::kDepth)) packets.fail("expected a packet of depth");
    fill_image(packets, depth_, mkv::kDepth, 1, frame.depth);
    fill_image(packets, body_index_, mkv::kBodyIndex, 1, frame.body_index);
    fill_image(packets, colour_, mkv::kColour, 3, frame.colour);
    frame.rows = depth_->size().rows;
    frame.cols = depth_->size().cols;
    frame.colour_rows = frame.colour.empty() ? 0 : colour_->size().rows;
    frame.colour_cols = frame.colour.empty() ? 0 : colour_->size().cols;
    skeletons_from_json(record.member("skeletons"), frame.skeletons);
    frame.calibration = calibration_;
    unmirror_images(*stored_, frame);
  }

  template <typename T>
  void fill_image(const JsonPlace& packets, std::optional<ImageTrack>& track, const char* name,
                  std::size_t channels, std::vector<T>& pixels) {
    pixels.clear();
    const auto hash = packets.find(name);
    if (!hash) return;
    if (!track) hash->fail("expected no packet: there is no such track");
    track->decode(packet_->pts, hash->text(), channels, pixels);
  }

  std::unique_ptr<MatroskaReader> file_;
  std::optional<std::int64_t> num_frames_;
  std::shared_ptr<const RgbdCalibration> stored_, calibration_;
  std::optional<ImageTrack> depth_, body_index_, colour_;
  int frames_track_ = -1;
  PacketPtr packet_ = new_packet();
  std::int64_t next_index_ = 0, last_time_ms_ = -1;
  std::int64_t frames_ = 0, damaged_ = 0, lost_ = 0;
  bool cut_short_ = false;
};

}  // namespace

std::unique_ptr<RgbdSource> open_mkv(const fs::path& path, const RgbdOptions& options) try {
  auto file = std::make_unique<MatroskaReader>(path);
  std::unique_ptr<RgbdSource> source;
  if (is_azure_recording(*file)) {
    source = open_azure(std::move(file), options);
  } else {
    source = std::make_unique<MkvSource>(std::move(file), options, count_frames(path));
  }
  if (options.speed == 0.0) return source;
  return in_real_time(std::move(source), options.speed);
} catch (const FormatError& error) {
  throw error.in_file(path.string());
}

}  // namespace manip3d
