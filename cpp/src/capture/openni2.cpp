#include "manip3d/capture/openni2.hpp"

#include <OpenNI.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <numbers>
#include <thread>
#include <utility>

#include "manip3d/capture/grab_thread.hpp"
#include "manip3d/capture/unmirror.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using std::chrono::milliseconds;

void check(openni::Status status, const char* action) {
  if (status == openni::STATUS_OK) return;
  std::string reason = openni::OpenNI::getExtendedError();
  while (!reason.empty() && std::isspace(static_cast<unsigned char>(reason.back()))) {
    reason.pop_back();
  }
  throw DeviceError(std::string("openni2: ") + action + ": " +
                    (reason.empty() ? "status " + std::to_string(status) : reason));
}

/// Keeps OpenNI2 initialised; it counts its users.
class Session {
 public:
  Session() { check(openni::OpenNI::initialize(), "cannot load its drivers"); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
  ~Session() { openni::OpenNI::shutdown(); }
};

class Unplugged final : public openni::OpenNI::DeviceDisconnectedListener {
 public:
  Unplugged() { openni::OpenNI::addDeviceDisconnectedListener(this); }
  Unplugged(const Unplugged&) = delete;
  Unplugged& operator=(const Unplugged&) = delete;
  ~Unplugged() override { openni::OpenNI::removeDeviceDisconnectedListener(this); }

  void onDeviceDisconnected(const openni::DeviceInfo* device) override {
    if (uri == device->getUri()) is_gone = true;
  }

  std::string uri;
  std::atomic<bool> is_gone = false;
};

/// Which colour images a device has to give.
enum class OpenNi2Color : std::uint8_t {
  kRegistered,  ///< Images with the pixels of depth only.
  kAny,         ///< Images with the pixels of depth, or else as they are.
  kAsTaken      ///< Images as they are, for a calibration with a registration of its own.
};

/// An open device.
class Device {
 public:
  explicit Device(const std::string& uri) {
    check(device_.open(uri.empty() ? openni::ANY_DEVICE : uri.c_str()), "cannot open");
    unplugged_.uri = device_.getDeviceInfo().getUri();
    check(depth_.create(device_, openni::SENSOR_DEPTH), "no depth");
    depth_.setMirroringEnabled(false);
  }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
  ~Device() {
    depth_.stop();
    if (color_.isValid()) color_.stop();
    // Streams of the Dummy device end some time after stop(), and must exist until then.
    std::this_thread::sleep_for(milliseconds(100));
    depth_.destroy();
    color_.destroy();
    device_.close();
  }

  void start_depth() { check(depth_.start(), "cannot start depth"); }

  void start_color(OpenNi2Color wanted) {
    const bool as_it_is = wanted != OpenNi2Color::kRegistered;
    if (!device_.hasSensor(openni::SENSOR_COLOR)) return;
    if (!set_registration(wanted != OpenNi2Color::kAsTaken) && !as_it_is) return;
    if (color_.create(device_, openni::SENSOR_COLOR) != openni::STATUS_OK) return;
    color_.setMirroringEnabled(false);
    openni::VideoMode mode = color_.getVideoMode();
    const openni::VideoMode depth = depth_.getVideoMode();
    const bool same_size = mode.getResolutionX() == depth.getResolutionX() &&
                           mode.getResolutionY() == depth.getResolutionY();
    if (mode.getPixelFormat() != openni::PIXEL_FORMAT_RGB888 || (!same_size && !as_it_is)) {
      mode.setPixelFormat(openni::PIXEL_FORMAT_RGB888);
      mode.setResolution(depth.getResolutionX(), depth.getResolutionY());
      if (color_.setVideoMode(mode) != openni::STATUS_OK) return color_.destroy();
    }
    device_.setDepthColorSyncEnabled(true);  // not supported by all devices
    check(color_.start(), "cannot start colour");
  }

  [[nodiscard]] RgbdCalibration calibration() const {
    const openni::VideoMode mode = depth_.getVideoMode();
    RgbdCalibration calibration;
    Intrinsics& camera = calibration.depth;
    camera.width = mode.getResolutionX();
    camera.height = mode.getResolutionY();
    camera.cx = 0.5 * static_cast<double>(camera.width - 1);
    camera.cy = 0.5 * static_cast<double>(camera.height - 1);
    camera.fx = 0.5 * static_cast<double>(camera.width) /
                std::tan(0.5 * static_cast<double>(depth_.getHorizontalFieldOfView()));
    camera.fy = 0.5 * static_cast<double>(camera.height) /
                std::tan(0.5 * static_cast<double>(depth_.getVerticalFieldOfView()));
    camera.mirrored = depth_.getMirroringEnabled();
    return calibration;
  }

  [[nodiscard]] bool has_color() const { return color_.isValid(); }

  /// Waits for the next image of any kind; null: none came in time.
  openni::VideoStream* wait(milliseconds timeout) {
    // The first ready stream is returned. If both are ready this is colour, which must not become
    // older.
    openni::VideoStream* streams[] = {&color_, &depth_};
    const int first = has_color() ? 0 : 1;
    int ready = 0;
    const openni::Status status = openni::OpenNI::waitForAnyStream(
        streams + first, 2 - first, &ready, static_cast<int>(timeout.count()));
    if (unplugged_.is_gone) throw DeviceError("openni2: " + unplugged_.uri + ": unplugged");
    if (status == openni::STATUS_TIME_OUT) return nullptr;
    check(status, "cannot wait");
    return streams[first + ready];
  }

  [[nodiscard]] bool is_depth(const openni::VideoStream* stream) const { return stream == &depth_; }

 private:
  /// Switches the device's own registration, which moves depth to the pixels of colour; returns
  /// whether it is as wanted.
  bool set_registration(bool is_on) {
    const auto mode =
        is_on ? openni::IMAGE_REGISTRATION_DEPTH_TO_COLOR : openni::IMAGE_REGISTRATION_OFF;
    return device_.isImageRegistrationModeSupported(mode) &&
           device_.setImageRegistrationMode(mode) == openni::STATUS_OK;
  }

  Session session_;
  Unplugged unplugged_;
  openni::Device device_;
  openni::VideoStream depth_, color_;
};

template <typename T>
void copy_rows(const openni::VideoFrameRef& from, std::size_t channels, std::vector<T>& to) {
  const std::size_t rows = from.getHeight();
  const std::size_t row = static_cast<std::size_t>(from.getWidth()) * channels;
  const auto* bytes = static_cast<const std::byte*>(from.getData());
  to.resize(rows * row);
  for (std::size_t v = 0; v < rows; ++v) {
    std::memcpy(to.data() + v * row, bytes + v * static_cast<std::size_t>(from.getStrideInBytes()),
                row * sizeof(T));
  }
}

class OpenNi2Camera final : public RgbdSource {
 public:
  OpenNi2Camera(std::string uri, std::shared_ptr<const RgbdCalibration> given)
      : uri_(std::move(uri)), given_(std::move(given)) {}

  [[nodiscard]] SourceCapabilities capabilities() const override { return {true}; }
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
    auto device = std::make_unique<Device>(uri_);
    stored_ = given_ ? given_ : told_by(*device);
    calibration_ = unmirrored(stored_);
    device->start_color(wanted_color());
    device->start_depth();
    device_ = std::move(device);
    last_number_ = 0;
    color_time_us_ = -1;
  }

  void stop() override { device_.reset(); }

  ReadStatus read(RgbdFrame& frame, milliseconds timeout) override {
    if (!device_) return ReadStatus::kEnd;
    openni::VideoStream* stream = device_->wait(timeout);
    if (stream == nullptr) return ReadStatus::kTimeout;
    openni::VideoFrameRef image;
    check(stream->readFrame(&image), "cannot read");
    if (!device_->is_depth(stream)) {
      take_color(image);
      return ReadStatus::kTimeout;
    }
    // no colour has come yet: the camera is starting
    if (device_->has_color() && color_time_us_ < 0) return ReadStatus::kTimeout;
    return take_depth(image, frame) ? ReadStatus::kFrame : ReadStatus::kTimeout;
  }

 private:
  [[nodiscard]] OpenNi2Color wanted_color() const {
    if (!given_) return OpenNi2Color::kRegistered;
    return given_->registration ? OpenNi2Color::kAsTaken : OpenNi2Color::kAny;
  }

  [[nodiscard]] std::shared_ptr<const RgbdCalibration> told_by(const Device& device) const {
    auto told = std::make_shared<RgbdCalibration>(device.calibration());
    try {
      check_intrinsics(told->depth);  // it is infinite for a field of view of 0
    } catch (const InputError&) {
      throw InputError("calibration: openni2:" + uri_ +
                       " tells no field of view; expected its camera");
    }
    return told;
  }

  void take_color(const openni::VideoFrameRef& image) {
    const auto& registration = stored_->registration;
    const Intrinsics& camera = registration ? registration->color : stored_->depth;
    if (image.getWidth() != camera.width || image.getHeight() != camera.height ||
        image.getVideoMode().getPixelFormat() != openni::PIXEL_FORMAT_RGB888) {
      ++damaged_;
      return;
    }
    copy_rows(image, 3, color_);
    color_time_us_ = static_cast<std::int64_t>(image.getTimestamp());
  }

  bool take_depth(const openni::VideoFrameRef& image, RgbdFrame& frame) {
    const openni::PixelFormat format = image.getVideoMode().getPixelFormat();
    const bool is_fine = format == openni::PIXEL_FORMAT_DEPTH_100_UM;
    if (image.getWidth() != stored_->depth.width || image.getHeight() != stored_->depth.height ||
        (format != openni::PIXEL_FORMAT_DEPTH_1_MM && !is_fine)) {
      ++damaged_;
      return false;
    }
    const auto time_us = static_cast<std::int64_t>(image.getTimestamp());
    frame.number = image.getFrameIndex();
    frame.time_ns = 1000 * time_us;
    frame.rows = image.getHeight();
    frame.cols = image.getWidth();
    copy_rows(image, 1, frame.depth);
    if (is_fine) {
      for (std::uint16_t& value : frame.depth) value = static_cast<std::uint16_t>((value + 5) / 10);
    }
    add_color(time_us, frame);
    frame.body_index.clear();
    frame.skeletons.clear();
    frame.calibration = calibration_;
    unmirror_images(*stored_, frame);
    if (last_number_ > 0 && frame.number > last_number_ + 1) {
      lost_ += frame.number - last_number_ - 1;
    }
    last_number_ = frame.number;
    ++frames_;
    return true;
  }

  void add_color(std::int64_t time_us, RgbdFrame& frame) {
    constexpr std::int64_t kMaxApart = 40'000;  // microseconds; images come every 33 ms
    frame.color.clear();
    frame.color_rows = frame.color_cols = 0;
    if (!device_->has_color()) return;
    if (std::abs(color_time_us_ - time_us) > kMaxApart) {
      ++without_color_;
      return;
    }
    const auto& registration = stored_->registration;
    const Intrinsics& camera = registration ? registration->color : stored_->depth;
    frame.color = color_;
    frame.color_rows = camera.height;
    frame.color_cols = camera.width;
  }

  std::string uri_;
  std::shared_ptr<const RgbdCalibration> given_, stored_, calibration_;
  std::unique_ptr<Device> device_;
  std::vector<std::uint8_t> color_;  // the latest image
  std::int64_t color_time_us_ = -1, last_number_ = 0;
  std::int64_t frames_ = 0, lost_ = 0, without_color_ = 0, damaged_ = 0;
};

}  // namespace

std::unique_ptr<RgbdSource> open_openni2(const std::string& uri, const RgbdOptions& options) {
  return std::make_unique<GrabThread>(std::make_unique<OpenNi2Camera>(uri, options.calibration));
}

std::string openni2_absence() try {
  const Session session;
  openni::Array<openni::DeviceInfo> devices;
  openni::OpenNI::enumerateDevices(&devices);
  return devices.getSize() > 0 ? "" : "no device";
} catch (const DeviceError& error) {
  return error.what();
}

}  // namespace manip3d
