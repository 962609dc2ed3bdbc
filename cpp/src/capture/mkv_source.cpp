#include <algorithm>
#include <array>
#include <optional>
#include <string_view>
#include <utility>

#include "capture/matroska.hpp"
#include "capture/mkv_azure.hpp"
#include "capture/mkv_layout.hpp"
#include "capture/mkv_library.hpp"
#include "capture/rgbd_json.hpp"
#include "capture/sha256.hpp"
#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"
#include "parse/json_text.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

// microseconds: duration of a packet, as the writer states it
constexpr std::int64_t kLasting = 1000;
constexpr int kMaxTries = 3;  // tries to find a frame by the index; a valid index needs two
constexpr int kLastEntry = std::numeric_limits<int>::max();
constexpr std::size_t kMaxRecordBytes = 1 << 20;  // bytes; 64 skeletons take 300 kB

[[noreturn]] void refuse_track(const char* name, const std::string& reason) {
  throw FormatError(std::string(name) + " track: " + reason, {});
}

std::string_view text_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// A track of images: its decoder and its latest packet.
class ImageTrack {
 public:
  ImageTrack(const char* name, MatroskaReader& file, int number, MkvPixels pixels, ImageSize size)
      : file_(file), number_(number), size_(size) {
    if (const std::string reason = mkv::complaint(size); !reason.empty()) {
      refuse_track(name, reason);
    }
    if (pixels == MkvPixels::kRgb && file.track(number).format == MkvFormat::kMjpeg) {
      jpeg_ = std::make_unique<JpegDecoder>();  // its packets state their own size
      return;
    }
    try {
      file.open_decoder(number, pixels, size);
    } catch (const FormatError& error) {
      refuse_track(name, error.reason());
    }
  }

  [[nodiscard]] int number() const { return number_; }
  [[nodiscard]] ImageSize size() const { return size_; }
  [[nodiscard]] bool has_packet() const { return !packet_.bytes.empty(); }

  /// Replaces the latest packet.
  void take(MatroskaPacket& packet) { std::swap(packet_, packet); }
  void drop() { packet_.bytes.clear(); }

  /// Decodes the latest packet, if it has this time and hash.
  /// @throws FormatError  it has another time or hash, or cannot be decoded.
  template <typename T>
  void decode(std::int64_t time_us, const std::string& hash, std::size_t channels,
              std::vector<T>& pixels) {
    if (!has_packet() || packet_.time_us != time_us) throw FormatError("packet missing", {});
    if (sha256(packet_.bytes) != hash) throw FormatError("packet damaged", {});
    pixels.resize(static_cast<std::size_t>(size_.rows * size_.cols) * channels);
    if (jpeg_) {
      jpeg_->decode(packet_.bytes, size_, reinterpret_cast<std::uint8_t*>(pixels.data()));
    } else {
      file_.decode(number_, packet_.bytes, pixels.data());
    }
  }

 private:
  MatroskaReader& file_;
  int number_;
  ImageSize size_;
  MatroskaPacket packet_;
  std::unique_ptr<JpegDecoder> jpeg_;
};

/// Names what a file holds that is no recording of this library.
void check_own_recording(const MatroskaReader& file) {
  const auto has = [&](const char* name, MkvKind kind) {
    return file.find(name, kind).has_value();
  };
  if (has(mkv::kDepth, MkvKind::kVideo) || has(mkv::kFrames, MkvKind::kText)) return;
  if (is_azure_recording_without_depth(file)) {
    throw FormatError(
        "a recording of an Azure Kinect without depth images: its depth mode was passive infrared "
        "or off",
        {});
  }
  throw FormatError(
      "expected a recording with the tracks 'depth' and 'frames', or the track 'DEPTH' of an Azure "
      "Kinect: this file holds no depth images",
      {});
}

/// The attached calibration; its hash is checked.
std::shared_ptr<const RgbdCalibration> read_calibration(const MatroskaReader& file) {
  const MkvTrack& attached = file.attachment(mkv::kCalibration);
  const std::span<const std::byte> bytes = from_mkv(attached.data);
  if (sha256(bytes) != attached.title) {
    throw FormatError("calibration.json: damaged: its hash is another", {});
  }
  const JsonPlace::Json json = parse_json(text_of(bytes), 0);
  const JsonPlace place(json, mkv::kCalibration, 0);
  return calibration_from_json(place);
}

/// Parses a record and checks its hash.
/// @throws FormatError  the record was changed or is too long.
JsonPlace::Json checked_record(const MatroskaPacket& packet) {
  if (packet.bytes.size() > kMaxRecordBytes) throw FormatError("record too long", {});
  const std::string_view text = text_of(packet.bytes);
  const std::string_view hash = text.substr(0, mkv::kHashDigits);
  const std::string_view json = text.substr(std::min(text.size(), mkv::kHashDigits + 1));
  if (sha256(std::as_bytes(std::span(json))) != hash) throw FormatError("record damaged", {});
  return parse_json(json, 0);
}

/// Whether a record is the one that the recorder writes if there were no frames: it has no JSON.
bool is_empty_record(const MatroskaPacket& packet) {
  static const std::string kEmpty = sha256({}) + "\n";
  return text_of(packet.bytes) == kEmpty;
}

std::int64_t index_of(const JsonPlace& record, std::int64_t least) {
  return record.member("index").integer(least, std::numeric_limits<std::int64_t>::max() - 1);
}

/// Whether the record of a file without frames comes first.
bool begins_with_empty_record(MatroskaReader& file, int frames) {
  MatroskaPacket packet;
  return file.next(packet) && packet.track == frames && is_empty_record(packet);
}

/// One more than the index of the last record; empty if the file was not finished, or its end is
/// cut off or damaged.
std::optional<std::int64_t> count_frames(const fs::path& path) try {
  MatroskaReader file(path);
  const auto depth = file.find(mkv::kDepth, MkvKind::kVideo);
  const auto frames = file.find(mkv::kFrames, MkvKind::kText);
  if (file.duration_us() == 0 || !depth || !frames) return std::nullopt;
  if (begins_with_empty_record(file, *frames)) return 0;
  if (file.seek(*depth, kLastEntry) == 0) return std::nullopt;
  std::optional<std::int64_t> count;
  for (MatroskaPacket packet; file.next(packet);) {
    if (packet.track != *frames || packet.time_us + kLasting < file.duration_us()) continue;
    const JsonPlace::Json json = checked_record(packet);
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
    open_tracks();
  }

  [[nodiscard]] SourceCapabilities capabilities() const override { return {}; }
  void start() override {}
  void stop() override { file_->unlock(); }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    return calibration_;
  }
  [[nodiscard]] std::optional<std::int64_t> num_frames() const override { return num_frames_; }
  [[nodiscard]] Conversions conversions() const override { return flips_of(*stored_); }
  [[nodiscard]] Counters counters() const override {
    Counters counters = {{"frames", frames_},
                         {"damaged", damaged_},
                         {"lost", lost_},
                         {"cut_short", cut_short_ ? 1 : 0},
                         {"unfinished", file_->duration_us() > 0 ? 0 : 1}};
    if (unregistered_color_ > 0) counters.emplace_back("unregistered_color", unregistered_color_);
    return counters;
  }

  ReadStatus read(RgbdFrame& frame, std::chrono::milliseconds) override {
    while (file_->next(packet_)) {
      if (packet_.track != frames_track_) {
        keep_image();
      } else if (read_frame(frame)) {
        ++frames_;
        return ReadStatus::kFrame;
      }
    }
    // Images without a record are of the frame that was being written when the recorder was killed.
    for (const auto* track : {&depth_, &body_index_, &color_}) {
      cut_short_ = cut_short_ || (*track && (*track)->has_packet());
    }
    cut_short_ = cut_short_ || last_time_us_ + kLasting < file_->duration_us();
    file_->unlock();
    return ReadStatus::kEnd;
  }

  void seek(std::int64_t index) override {
    check_frame_index(index);
    file_->lock();
    const bool is_ahead = index >= next_index_;
    // Packets before the frame are read but not decoded: the index in their records is below
    // next_index_.
    const bool reads_on = is_ahead && (index == next_index_ || file_->duration_us() == 0);
    if (!reads_on && !go_to_entry(index)) rewind();
    drop_images();
    next_index_ = index;
  }

  void read_at(std::int64_t index, RgbdFrame& frame) override {
    RgbdSource::read_at(index, frame);
    if (next_index_ == index + 1) return;
    seek(index + 1);
    throw FormatError("frame " + std::to_string(index) + " is damaged or lost", {})
        .in_file(file_->path().string());
  }

 private:
  void open_tracks() {
    const Intrinsics& depth = calibration_->depth;
    const Intrinsics& color =
        calibration_->registration ? calibration_->registration->color : depth;
    add_track(mkv::kDepth, MkvPixels::kGray16, {depth.height, depth.width}, depth_);
    add_track(mkv::kBodyIndex, MkvPixels::kGray8, {depth.height, depth.width}, body_index_);
    if (is_color_registered()) {
      add_track(mkv::kColor, MkvPixels::kRgb, {color.height, color.width}, color_);
    }
    const auto frames = file_->find(mkv::kFrames, MkvKind::kText);
    if (!depth_ || !frames) throw FormatError("expected the tracks 'depth' and 'frames'", {});
    frames_track_ = *frames;
  }

  /// Without a registration, the depth pixels of colours of another size are unknown.
  [[nodiscard]] bool is_color_registered() const {
    const auto number = file_->find(mkv::kColor, MkvKind::kVideo);
    if (!number || calibration_->registration) return true;
    const MkvTrack& images = file_->track(*number);
    return images.width == calibration_->depth.width && images.height == calibration_->depth.height;
  }

  void rewind() {
    auto file = std::make_unique<MatroskaReader>(file_->path());
    // they refer to the old file
    for (auto* track : {&depth_, &body_index_, &color_}) track->reset();
    file_ = std::move(file);
    open_tracks();
  }

  /// Goes to the last packet in the index that is not after a frame; returns false if there is
  /// none. The position of an entry is the index of its frame, or lower if earlier frames have no
  /// entry.
  bool go_to_entry(std::int64_t index) {
    auto entry = static_cast<int>(std::min<std::int64_t>(index, kLastEntry));
    for (int tries = 0; depth_ && tries < kMaxTries; ++tries) {
      const int entries = file_->seek(depth_->number(), entry);
      entry = std::min(entry, entries - 1);
      const std::optional<std::int64_t> found = entries == 0 ? std::nullopt : first_index();
      if (found && *found <= index) return file_->seek(depth_->number(), entry) > 0;
      if (!found || entry <= 0) return false;
      entry = static_cast<int>(std::max<std::int64_t>(entry - (*found - index), 0));
    }
    return false;
  }

  /// The index of the first frame from here on with an intact record.
  std::optional<std::int64_t> first_index() {
    while (file_->next(packet_)) {
      if (packet_.track != frames_track_) continue;
      try {
        const JsonPlace::Json json = checked_record(packet_);
        return index_of(JsonPlace(json, mkv::kFrames, 0), 0);
      } catch (const FormatError&) {
        continue;  // counted when the frame is read
      }
    }
    return std::nullopt;
  }

  void add_track(const char* name, MkvPixels pixels, ImageSize size,
                 std::optional<ImageTrack>& track) {
    if (const auto number = file_->find(name, MkvKind::kVideo)) {
      track.emplace(name, *file_, *number, pixels, size);
    }
  }

  void keep_image() {
    for (auto* track : {&depth_, &body_index_, &color_}) {
      if (*track && (*track)->number() == packet_.track) (*track)->take(packet_);
    }
  }

  /// Decodes the frame whose record has just been read; returns false if it is incomplete or there
  /// is none. A damaged record appears as a gap before the next one.
  bool read_frame(RgbdFrame& frame) {
    if (is_empty_record(packet_)) {
      last_time_us_ = packet_.time_us;
      drop_images();
      return false;
    }
    bool is_known = false;  // the record is intact, so that the frame counts
    try {
      const JsonPlace::Json json = checked_record(packet_);
      const JsonPlace record(json, mkv::kFrames, 0);
      last_time_us_ = packet_.time_us;
      const std::int64_t index = index_of(record, next_index_);
      lost_ += index - std::exchange(next_index_, index + 1);
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
    for (auto* track : {&depth_, &body_index_, &color_}) {
      if (*track) (*track)->drop();
    }
  }

  void fill(const JsonPlace& record, RgbdFrame& frame) {
    constexpr std::int64_t kMinInteger = std::numeric_limits<std::int64_t>::min();
    constexpr std::int64_t kMaxInteger = std::numeric_limits<std::int64_t>::max();
    frame.number = record.member("number").integer(kMinInteger, kMaxInteger);
    frame.time_ns = record.member("time").integer(kMinInteger, kMaxInteger);
    const JsonPlace packets = record.member("packets");
    if (!packets.has(mkv::kDepth)) packets.fail("expected a packet of depth");
    fill_image(packets, depth_, mkv::kDepth, 1, frame.depth);
    fill_image(packets, body_index_, mkv::kBodyIndex, 1, frame.body_index);
    const bool has_unregistered_color = packets.has(mkv::kColor) && !is_color_registered();
    if (has_unregistered_color) {
      frame.color.clear();
    } else {
      fill_image(packets, color_, mkv::kColor, 3, frame.color);
    }
    frame.rows = depth_->size().rows;
    frame.cols = depth_->size().cols;
    frame.color_rows = frame.color.empty() ? 0 : color_->size().rows;
    frame.color_cols = frame.color.empty() ? 0 : color_->size().cols;
    skeletons_from_json(record.member("skeletons"), frame.skeletons);
    frame.calibration = calibration_;
    unmirror_images(*stored_, frame);
    unregistered_color_ += has_unregistered_color ? 1 : 0;
  }

  template <typename T>
  void fill_image(const JsonPlace& packets, std::optional<ImageTrack>& track, const char* name,
                  std::size_t channels, std::vector<T>& pixels) {
    pixels.clear();
    const auto hash = packets.find(name);
    if (!hash) return;
    if (!track) hash->fail("expected no packet: there is no such track");
    track->decode(packet_.time_us, hash->text(), channels, pixels);
  }

  std::unique_ptr<MatroskaReader> file_;
  std::optional<std::int64_t> num_frames_;
  std::shared_ptr<const RgbdCalibration> stored_, calibration_;
  std::optional<ImageTrack> depth_, body_index_, color_;
  int frames_track_ = -1;
  MatroskaPacket packet_;
  std::int64_t next_index_ = 0, last_time_us_ = -kLasting;
  std::int64_t frames_ = 0, damaged_ = 0, lost_ = 0, unregistered_color_ = 0;
  bool cut_short_ = false;
};

}  // namespace

std::unique_ptr<RgbdSource> open_mkv(const fs::path& path, const RgbdOptions& options) try {
  auto file = std::make_unique<MatroskaReader>(path);
  std::unique_ptr<RgbdSource> source;
  if (is_azure_recording(*file)) {
    source = open_azure(std::move(file), options);
  } else {
    check_own_recording(*file);
    source = std::make_unique<MkvSource>(std::move(file), options, count_frames(path));
  }
  if (options.speed == 0.0) return source;
  return in_real_time(std::move(source), options.speed);
} catch (const FormatError& error) {
  throw error.in_file(path.string());
}

}  // namespace manip3d
