#include <libfreenect2/frame_listener_impl.h>
#include <libfreenect2/logger.h>
#include <libfreenect2/registration.h>

#include <chrono>
#include <libfreenect2/libfreenect2.hpp>
#include <memory>
#include <string>

#include "capture/sdk_camera.hpp"
#include "manip3d/capture/sdk_cameras.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using libfreenect2::Frame;
using libfreenect2::FrameMap;

constexpr int kRows = 424, kCols = 512;

SdkImage image_of(const Frame& frame, SdkPixels pixels) {
  return {frame.data, kRows, kCols, kCols * 4, pixels};
}

class KinectV2 final : public SdkDevice {
 public:
  explicit KinectV2(const std::string& serial) {
    libfreenect2::setGlobalLogger(nullptr);  // it writes to standard output
    if (library_.enumerateDevices() == 0) throw DeviceError("freenect2: no device");
    const std::string which = serial.empty() ? library_.getDefaultDeviceSerialNumber() : serial;
    device_.reset(library_.openDevice(which));
    if (!device_) throw DeviceError("freenect2: cannot open " + which);
    device_->setColorFrameListener(&images_);
    device_->setIrAndDepthFrameListener(&images_);
    if (!device_->start()) throw DeviceError("freenect2: cannot start " + which);
    lens_ = device_->getIrCameraParams();
    registration_ =
        std::make_unique<libfreenect2::Registration>(lens_, device_->getColorCameraParams());
  }
  ~KinectV2() override {
    if (!device_) return;
    device_->stop();
    device_->close();
  }

  [[nodiscard]] Intrinsics camera() const override {
    Intrinsics camera;
    camera.width = kCols;
    camera.height = kRows;
    camera.fx = lens_.fx;
    camera.fy = lens_.fy;
    // The pixel centres of Registration::getPointXYZRGB are half integers: (column + 0.5 - cx) /
    // fx.
    camera.cx = static_cast<double>(lens_.cx) - 0.5;
    camera.cy = static_cast<double>(lens_.cy) - 0.5;
    camera.mirrored = true;
    return camera;
  }

  ReadStatus wait(SdkFrame& frame, std::chrono::milliseconds timeout) override {
    FrameMap images;
    if (!images_.waitForNewFrame(images, static_cast<int>(timeout.count()))) {
      return ReadStatus::kTimeout;
    }
    const Frame& depth = *images[Frame::Depth];
    const Frame& color = *images[Frame::Color];
    registration_->apply(&color, &depth, &undistorted_, &registered_);
    frame.depth = image_of(undistorted_, SdkPixels::kDepthFloat);
    frame.color =
        image_of(registered_, color.format == Frame::RGBX ? SdkPixels::kRgbx : SdkPixels::kBgrx);
    frame.number = depth.sequence;
    ticks_ += static_cast<std::uint32_t>(depth.timestamp - last_ticks_);  // the counter has 32 bits
    last_ticks_ = depth.timestamp;
    frame.time_ns = ticks_ * 125'000;  // ticks of 0.125 ms
    images_.release(images);
    return ReadStatus::kFrame;
  }

 private:
  libfreenect2::Freenect2 library_;
  libfreenect2::SyncMultiFrameListener images_{Frame::Color | Frame::Depth};
  Frame undistorted_{kCols, kRows, 4}, registered_{kCols, kRows, 4};
  std::unique_ptr<libfreenect2::Freenect2Device> device_;
  libfreenect2::Freenect2Device::IrCameraParams lens_{};
  std::unique_ptr<libfreenect2::Registration> registration_;
  std::int64_t ticks_ = 0;
  std::uint32_t last_ticks_ = 0;
};

}  // namespace

std::unique_ptr<RgbdSource> open_freenect2(const std::string& location,
                                           const RgbdOptions& options) {
  const SdkLocation at = parse_sdk_location("freenect2", location, {});
  return open_sdk_camera(
      "freenect2", [at] { return std::make_unique<KinectV2>(at.place); }, options, kSdkSilence);
}

std::string freenect2_absence() {
  libfreenect2::setGlobalLogger(nullptr);
  return libfreenect2::Freenect2().enumerateDevices() > 0 ? "" : "no device";
}

}  // namespace manip3d
