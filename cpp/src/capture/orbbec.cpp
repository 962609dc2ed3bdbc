#include <libobsensor/ObSensor.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <memory>
#include <string>

#include "capture/sdk_camera.hpp"
#include "manip3d/capture/sdk_cameras.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

void raise(ob_error* error) {
  if (error == nullptr) return;
  const std::string text = std::string("orbbec: ") + ob_error_get_message(error);
  ob_delete_error(error);
  throw DeviceError(text);
}

template <typename Function, typename... Arguments>
auto call(Function function, Arguments... arguments) {
  return sdk_call<ob_error>(raise, function, arguments...);
}

template <auto kDelete>
struct Deleter {
  template <typename T>
  void operator()(T* object) const {
    ob_error* ignored = nullptr;
    kDelete(object, &ignored);
    if (ignored != nullptr) ob_delete_error(ignored);
  }
};
template <typename T, auto kDelete>
using Handle = std::unique_ptr<T, Deleter<kDelete>>;

using Context = Handle<ob_context, ob_delete_context>;
using Device = Handle<ob_device, ob_delete_device>;
using Frame = Handle<ob_frame, ob_delete_frame>;

Context new_context() {
  call(ob_set_logger_severity, OB_LOG_SEVERITY_OFF);  // it writes to the console and to files
  return Context(call(ob_create_context));
}

Device open_device(ob_context* context, const std::string& serial) {
  const Handle<ob_device_list, ob_delete_device_list> devices(call(ob_query_device_list, context));
  if (call(ob_device_list_get_count, devices.get()) == 0) throw DeviceError("orbbec: no device");
  return Device(serial.empty() ? call(ob_device_list_get_device, devices.get(), 0U)
                               : call(ob_device_list_get_device_by_serial_number, devices.get(),
                                      serial.c_str()));
}

bool has_color(const ob_device* device) {
  const Handle<ob_sensor_list, ob_delete_sensor_list> sensors(
      call(ob_device_get_sensor_list, device));
  for (std::uint32_t i = 0; i < call(ob_sensor_list_get_count, sensors.get()); ++i) {
    if (call(ob_sensor_list_get_sensor_type, sensors.get(), i) == OB_SENSOR_COLOR) return true;
  }
  return false;
}

SdkImage image_of(const ob_frame* frame) {
  SdkImage image;
  image.rows = call(ob_video_frame_get_height, frame);
  image.cols = call(ob_video_frame_get_width, frame);
  image.row_bytes = call(ob_frame_get_data_size, frame) / std::max<std::int64_t>(image.rows, 1);
  image.data = call(ob_frame_get_data, frame);
  switch (call(ob_frame_get_format, frame)) {
    case OB_FORMAT_Y16:
      image.pixels = SdkPixels::kDepth16;
      break;
    case OB_FORMAT_RGB:
      image.pixels = SdkPixels::kRgb;
      break;
    case OB_FORMAT_BGR:
      image.pixels = SdkPixels::kBgr;
      break;
    case OB_FORMAT_RGBA:
      image.pixels = SdkPixels::kRgbx;
      break;
    case OB_FORMAT_BGRA:
      image.pixels = SdkPixels::kBgrx;
      break;
    default:
      image.data = nullptr;
  }
  return image;
}

class Orbbec final : public SdkDevice {
 public:
  Orbbec(const SdkLocation& at, bool is_file)
      : is_file_(is_file),
        context_(new_context()),
        device_(is_file ? Device(call(ob_create_playback_device, at.place.c_str()))
                        : open_device(context_.get(), at.place)),
        pipeline_(call(ob_create_pipeline_with_device, device_.get())),
        align_(call(ob_create_filter, "Align")) {
    call(ob_filter_set_config_value, align_.get(), "AlignType", double{OB_STREAM_DEPTH});
    const Handle<ob_config, ob_delete_config> config(call(ob_create_config));
    const auto option = [&](const char* name) {  // 0: any
      return static_cast<std::uint32_t>(at.options.at(name));
    };
    call(ob_config_enable_video_stream, config.get(), OB_STREAM_DEPTH, option("width"),
         option("height"), option("rate"), OB_FORMAT_Y16);
    if (has_color(device_.get())) {
      call(ob_config_enable_video_stream, config.get(), OB_STREAM_COLOR, 0U, 0U, option("rate"),
           OB_FORMAT_RGB);
      call(ob_pipeline_enable_frame_sync, pipeline_.get());
    }
    call(ob_pipeline_start_with_config, pipeline_.get(), config.get());
    is_started_ = true;
  }
  ~Orbbec() override {
    ob_error* ignored = nullptr;
    if (is_started_) ob_pipeline_stop(pipeline_.get(), &ignored);
    if (ignored != nullptr) ob_delete_error(ignored);
  }

  [[nodiscard]] Intrinsics camera() const override {
    const ob_camera_param told = call(ob_pipeline_get_camera_param, pipeline_.get());
    const ob_camera_distortion& lens = told.depthDistortion;
    Intrinsics camera;
    camera.width = told.depthIntrinsic.width;
    camera.height = told.depthIntrinsic.height;
    camera.fx = told.depthIntrinsic.fx;
    camera.fy = told.depthIntrinsic.fy;
    camera.cx = told.depthIntrinsic.cx;
    camera.cy = told.depthIntrinsic.cy;
    camera.distortion = {lens.k1, lens.k2, lens.p1, lens.p2, lens.k3};
    camera.mirrored = told.isMirrored;
    const bool is_browns =
        lens.k4 == 0.0F && lens.k5 == 0.0F && lens.k6 == 0.0F &&
        (lens.model == OB_DISTORTION_BROWN_CONRADY || lens.model == OB_DISTORTION_BROWN_CONRADY_K6);
    const bool is_straight = camera.distortion == std::array<double, 5>{} && lens.k4 == 0.0F &&
                             lens.k5 == 0.0F && lens.k6 == 0.0F;
    if (!is_browns && !is_straight) {
      throw InputError("calibration: orbbec: tells a lens of the kind " +
                       std::to_string(lens.model) + "; expected its camera");
    }
    return camera;
  }

  ReadStatus wait(SdkFrame& frame, std::chrono::milliseconds timeout) override {
    const Frame images(call(ob_pipeline_wait_for_frameset, pipeline_.get(),
                            static_cast<std::uint32_t>(timeout.count())));
    if (!images) return is_over() ? ReadStatus::kEnd : ReadStatus::kTimeout;
    const Frame aligned(call(ob_filter_process, align_.get(), images.get()));
    const ob_frame* set = aligned ? aligned.get() : images.get();
    depth_.reset(call(ob_frameset_get_depth_frame, set));
    color_.reset(call(ob_frameset_get_color_frame, set));
    if (!depth_) return ReadStatus::kTimeout;
    frame.depth = image_of(depth_.get());
    if (color_) frame.color = image_of(color_.get());
    frame.millimetres = static_cast<double>(call(ob_depth_frame_get_value_scale, depth_.get()));
    frame.number = static_cast<std::int64_t>(call(ob_frame_get_index, depth_.get()));
    frame.time_ns = 1000 * static_cast<std::int64_t>(call(ob_frame_get_timestamp_us, depth_.get()));
    return ReadStatus::kFrame;
  }

 private:
  [[nodiscard]] bool is_over() const {
    return is_file_ && call(ob_playback_device_get_current_playback_status, device_.get()) ==
                           OB_PLAYBACK_STOPPED;
  }

  bool is_file_, is_started_ = false;
  Context context_;
  Device device_;
  Handle<ob_pipeline, ob_delete_pipeline> pipeline_;
  Handle<ob_filter, ob_delete_filter> align_;
  Frame depth_, color_;
};

}  // namespace

std::unique_ptr<RgbdSource> open_orbbec(const std::string& location, const RgbdOptions& options) {
  const SdkLocation at = parse_sdk_location("orbbec", location, {"width", "height", "rate"});
  const bool is_file = at.place.ends_with(".bag");
  const auto open = [at, is_file] { return std::make_unique<Orbbec>(at, is_file); };
  if (is_file) return open_sdk_file("orbbec", at.place, open, options);
  return open_sdk_camera("orbbec", open, options, kSdkSilence);
}

std::string orbbec_absence() try {
  const Context context = new_context();
  const Handle<ob_device_list, ob_delete_device_list> devices(
      call(ob_query_device_list, context.get()));
  return call(ob_device_list_get_count, devices.get()) > 0 ? "" : "no device";
} catch (const DeviceError& error) {
  return error.what();
}

}  // namespace manip3d
