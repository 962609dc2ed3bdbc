#include "capture/sdk_camera.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <optional>
#include <utility>

#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

bool is_depth(SdkPixels pixels) {
  return pixels == SdkPixels::kDepth16 || pixels == SdkPixels::kDepthFloat;
}

const std::byte* row_of(const SdkImage& image, std::int64_t v) {
  return static_cast<const std::byte*>(image.data) + v * image.row_bytes;
}

std::uint16_t to_millimetres(double depth) {
  if (!(depth > 0.0 && depth < 65535.5)) return 0;  // also for NaN and values that do not fit
  return static_cast<std::uint16_t>(std::floor(depth + 0.5));
}

template <typename T>
void convert_depth(const SdkImage& from, double millimetres, std::uint16_t* to) {
  for (std::int64_t v = 0; v < from.rows; ++v) {
    const std::byte* row = row_of(from, v);
    for (std::int64_t u = 0; u < from.cols; ++u) {
      T value;
      std::memcpy(&value, row + static_cast<std::size_t>(u) * sizeof(T), sizeof(T));
      *to++ = to_millimetres(millimetres * static_cast<double>(value));
    }
  }
}

void convert_color(const SdkImage& from, std::uint8_t* to) {
  const bool has_pad = from.pixels == SdkPixels::kRgbx || from.pixels == SdkPixels::kBgrx;
  const bool is_bgr = from.pixels == SdkPixels::kBgr || from.pixels == SdkPixels::kBgrx;
  const int red = is_bgr ? 2 : 0;
  for (std::int64_t v = 0; v < from.rows; ++v) {
    const auto* pixel = reinterpret_cast<const std::uint8_t*>(row_of(from, v));
    for (std::int64_t u = 0; u < from.cols; ++u, pixel += has_pad ? 4 : 3, to += 3) {
      to[0] = pixel[red];
      to[1] = pixel[1];
      to[2] = pixel[2 - red];
    }
  }
}

/// A calibration without its registration, because the SDK has brought colour to the pixels of
/// depth.
std::shared_ptr<const RgbdCalibration> without_registration(
    std::shared_ptr<const RgbdCalibration> given) {
  if (!given || !given->registration) return given;
  auto calibration = std::make_shared<RgbdCalibration>(*given);
  calibration->registration.reset();
  return calibration;
}

class SdkCamera final : public RgbdSource {
 public:
  /// @param silence  Longest time without images before the camera counts as unplugged; empty: a
  ///                 file.
  SdkCamera(std::string scheme, SdkOpener open, std::shared_ptr<const RgbdCalibration> given,
            std::optional<milliseconds> silence)
      : scheme_(std::move(scheme)),
        open_(std::move(open)),
        given_(without_registration(std::move(given))),
        silence_(silence) {}

  [[nodiscard]] SourceCapabilities capabilities() const override { return {silence_.has_value()}; }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    return calibration_;
  }
  [[nodiscard]] Counters counters() const override {
    return {{"frames", frames_},
            {"lost_by_camera", lost_},
            {"without_color", without_color_},
            {"damaged", damaged_}};
  }

  void start() override {
    stop();
    auto device = open_();
    stored_ = given_ ? given_ : told_by(*device);
    calibration_ = unmirrored(stored_);
    device_ = std::move(device);
    last_number_.reset();
    last_image_ = Clock::now();
  }

  void stop() override { device_.reset(); }

  ReadStatus read(RgbdFrame& frame, milliseconds timeout) override {
    if (!device_) return ReadStatus::kEnd;
    SdkFrame images;
    const ReadStatus status = device_->wait(images, timeout);
    const auto now = Clock::now();
    if (status == ReadStatus::kTimeout && silence_ && now - last_image_ > *silence_) {
      throw DeviceError(scheme_ + ": no images for " + std::to_string(silence_->count()) +
                        " ms: unplugged?");
    }
    if (status != ReadStatus::kFrame) return status;
    last_image_ = now;
    return fill(images, frame) ? ReadStatus::kFrame : ReadStatus::kTimeout;
  }

 private:
  static std::shared_ptr<const RgbdCalibration> told_by(const SdkDevice& device) {
    auto told = std::make_shared<RgbdCalibration>();
    told->depth = device.camera();
    check_intrinsics(told->depth, "calibration.depth");
    return told;
  }

  [[nodiscard]] bool fits(const SdkImage& image, bool as_depth) const {
    return image.rows == stored_->depth.height && image.cols == stored_->depth.width &&
           is_depth(image.pixels) == as_depth;
  }

  bool fill(const SdkFrame& images, RgbdFrame& frame) {
    if (images.depth.data == nullptr || !fits(images.depth, true)) {
      ++damaged_;
      return false;
    }
    frame.number = images.number;
    frame.time_ns = images.time_ns;
    frame.rows = images.depth.rows;
    frame.cols = images.depth.cols;
    frame.depth.resize(frame.rows * frame.cols);
    if (images.depth.pixels == SdkPixels::kDepth16) {
      convert_depth<std::uint16_t>(images.depth, images.millimetres, frame.depth.data());
    } else {
      convert_depth<float>(images.depth, images.millimetres, frame.depth.data());
    }
    fill_color(images.color, frame);
    frame.body_index.clear();
    frame.skeletons.clear();
    frame.calibration = calibration_;
    unmirror_images(*stored_, frame);
    if (last_number_ && frame.number > *last_number_ + 1) lost_ += frame.number - *last_number_ - 1;
    last_number_ = frame.number;
    ++frames_;
    return true;
  }

  void fill_color(const SdkImage& image, RgbdFrame& frame) {
    frame.color.clear();
    frame.color_rows = frame.color_cols = 0;
    if (image.data == nullptr || !fits(image, false)) {
      ++without_color_;
      return;
    }
    frame.color_rows = image.rows;
    frame.color_cols = image.cols;
    frame.color.resize(3 * image.rows * image.cols);
    convert_color(image, frame.color.data());
  }

  std::string scheme_;
  SdkOpener open_;
  std::shared_ptr<const RgbdCalibration> given_, stored_, calibration_;
  std::optional<milliseconds> silence_;
  std::unique_ptr<SdkDevice> device_;
  Clock::time_point last_image_;
  std::optional<std::int64_t> last_number_;
  std::int64_t frames_ = 0, lost_ = 0, without_color_ = 0, damaged_ = 0;
};

}  // namespace

SdkLocation parse_sdk_location(const std::string& scheme, const std::string& location,
                               std::initializer_list<const char*> options) {
  SdkLocation parsed;
  std::string known;
  for (const char* name : options) {
    parsed.options[name] = 0;
    known += (known.empty() ? "" : ", ") + std::string(name);
  }
  const std::size_t mark = std::min(location.find('?'), location.size());
  parsed.place = location.substr(0, mark);
  for (std::size_t begin = mark + 1; begin < location.size();) {
    const std::size_t end = std::min(location.find('&', begin), location.size());
    const std::string option = location.substr(begin, end - begin);
    const std::size_t equals = std::min(option.find('='), option.size());
    const auto found = parsed.options.find(option.substr(0, equals));
    int value = 0;
    if (equals < option.size()) {
      std::from_chars(option.data() + equals + 1, option.data() + option.size(), value);
    }
    if (found == parsed.options.end() || option != found->first + "=" + std::to_string(value) ||
        value <= 0) {
      throw InputError("uri: expected options of " + scheme + ": (" +
                       (known.empty() ? "there are none" : known) + ") with whole numbers > 0, " +
                       "got '" + option + "'");
    }
    found->second = value;
    begin = end + 1;
  }
  return parsed;
}

std::unique_ptr<RgbdSource> open_sdk_camera(const std::string& scheme, SdkOpener open,
                                            const RgbdOptions& options, milliseconds silence) {
  return std::make_unique<GrabThread>(
      std::make_unique<SdkCamera>(scheme, std::move(open), options.calibration, silence));
}

std::unique_ptr<RgbdSource> open_sdk_file(const std::string& scheme,
                                          const std::filesystem::path& path, SdkOpener open,
                                          const RgbdOptions& options) {
  // throws if there is no file; libraries take up to a minute to notice that
  static_cast<void>(std::filesystem::file_size(path));
  auto file =
      std::make_unique<SdkCamera>(scheme, std::move(open), options.calibration, std::nullopt);
  if (options.speed == 0.0) return file;
  return in_real_time(std::move(file), options.speed);
}

}  // namespace manip3d
