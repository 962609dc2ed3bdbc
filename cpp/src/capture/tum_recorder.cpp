#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <string>
#include <utility>

#include "capture/image_codec.hpp"
#include "capture/recording_folder.hpp"
#include "manip3d/capture/folder.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

namespace fs = std::filesystem;

constexpr int kUnitsPerMillimetre = 5;  // the unit is 1/5000 m
// 65535 units would be read as "no measurement".
constexpr int kFarthest = (std::numeric_limits<std::uint16_t>::max() - 1) / kUnitsPerMillimetre;
constexpr std::int64_t kNanoseconds = 1'000'000'000;
// the latest time that open_tum() reads
constexpr std::int64_t kLatest = 9'000'000'000 * kNanoseconds;
constexpr std::array kLists = {"depth.txt", "rgb.txt", "associations.txt"};

/// The time in seconds with nine decimals.
std::string seconds_text(std::int64_t time_ns) {
  const std::int64_t size = std::abs(time_ns);
  char text[32];
  std::snprintf(text, sizeof(text), "%s%lld.%09lld", time_ns < 0 ? "-" : "",
                static_cast<long long>(size / kNanoseconds),
                static_cast<long long>(size % kNanoseconds));
  return text;
}

class TumRecorder final : public RgbdRecorder {
 public:
  TumRecorder(const fs::path& folder, const RgbdCalibration& calibration,
              const RecorderOptions& options)
      : folder_(folder), checks_(calibration) {
    if (calibration.registration) {
      throw InputError(
          "calibration: expected colour images of the depth camera: a TUM sequence "
          "has no registration");
    }
    calibration_text_ = calibration_text(calibration);
    lock_ = prepare_folder(folder, layout_, options.overwrite);
    if (fs::is_empty(folder)) begin();  // else the earlier recording is kept until the first frame
  }

  void write(const RgbdFrame& frame) override {
    if (is_closed_) throw InputError("write: the recording is closed");
    RecordingChecks checks = checks_;
    checks.check(frame);
    if (frame.time_ns < -kLatest || frame.time_ns > kLatest) {
      throw InputError("frame.time_ns: expected at most 9e9 seconds, got " +
                       std::to_string(frame.time_ns) + " ns");
    }
    if (!pairs_) begin();
    const std::string time = seconds_text(frame.time_ns);
    const std::string depth = time + " depth/" + time + ".png";
    const std::string color = time + " rgb/" + time + ".png";
    FrameImages images;
    const std::int64_t too_far = to_units(frame.depth);
    images.write(folder_ / "depth" / (time + ".png"), encode_png(units_, frame.cols));
    const bool has_color = !frame.color.empty();
    if (has_color) {
      images.write(folder_ / "rgb" / (time + ".png"), encode_png(frame.color, frame.cols, 3));
    }
    const std::int64_t bytes = images.keep();  // images are complete before a list names them
    if (has_color) color_->append(color + "\n");
    depth_->append(depth + "\n");  // this line completes the frame
    if (has_color) pairs_->append(color + " " + depth + "\n");
    bytes_ += bytes;
    too_far_ += too_far;
    checks_ = checks;
    ++frames_;
  }

  void close() override {
    if (std::exchange(is_closed_, true)) return;
    for (LineLog* list : {depth_.get(), color_.get(), pairs_.get()}) {
      if (list != nullptr) list->close();
    }
    lock_->release();
  }

  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_}, {"bytes", bytes_}, {"too_far", too_far_}};
  }

 private:
  void begin() {
    remove_recording(folder_, layout_);
    write_text(folder_ / kCalibrationFile, calibration_text_);
    depth_ = begun_list("depth.txt", "# depth maps\n# timestamp filename\n");
    color_ = begun_list("rgb.txt", "# color images\n# timestamp filename\n");
    pairs_ = begun_list("associations.txt", "");  // made last: if it exists, all lists do
  }

  [[nodiscard]] std::unique_ptr<LineLog> begun_list(const char* name, const std::string& head) {
    auto list = std::make_unique<LineLog>(folder_ / name);
    list->append(head);
    return list;
  }

  /// Converts depths to units_; returns the number of pixels that are beyond kFarthest and
  /// become 0.
  std::int64_t to_units(const std::vector<std::uint16_t>& depth) {
    std::int64_t too_far = 0;
    units_.resize(depth.size());
    std::ranges::transform(depth, units_.begin(), [&](std::uint16_t millimetres) {
      const bool fits = millimetres <= kFarthest;
      too_far += fits ? 0 : 1;
      return static_cast<std::uint16_t>(fits ? kUnitsPerMillimetre * millimetres : 0);
    });
    return too_far;
  }

  const RecordingLayout layout_{{kLists.begin(), kLists.end()}, {"depth", "rgb"}};
  fs::path folder_;
  std::string calibration_text_;
  RecordingChecks checks_;
  std::unique_ptr<RecordingLock> lock_;
  std::unique_ptr<LineLog> depth_, color_, pairs_;
  std::vector<std::uint16_t> units_;
  std::int64_t frames_ = 0, bytes_ = 0, too_far_ = 0;
  bool is_closed_ = false;
};

}  // namespace

std::unique_ptr<RgbdRecorder> record_tum(const fs::path& folder,
                                         std::shared_ptr<const RgbdCalibration> calibration,
                                         const RecorderOptions& options) {
  return std::make_unique<TumRecorder>(folder, *calibration, options);
}

}  // namespace manip3d
