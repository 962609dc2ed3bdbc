#include <librealsense2/h/rs_pipeline.h>
#include <librealsense2/rs.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <memory>
#include <string>

#include "capture/sdk_camera.hpp"
#include "manip3d/capture/sdk_cameras.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

void raise(rs2_error* error) {
  if (error == nullptr) return;
  const std::string text = std::string("realsense: ") + rs2_get_error_message(error);
  rs2_free_error(error);
  throw DeviceError(text);
}

template <typename Function, typename... Arguments>
auto call(Function function, Arguments... arguments) {
  return sdk_call<rs2_error>(raise, function, arguments...);
}

template <auto kDelete>
struct Deleter {
  template <typename T>
  void operator()(T* object) const {
    kDelete(object);
  }
};
template <typename T, auto kDelete>
using Handle = std::unique_ptr<T, Deleter<kDelete>>;

using Context = Handle<rs2_context, rs2_delete_context>;
using Frame = Handle<rs2_frame, rs2_release_frame>;
using Profile = Handle<rs2_pipeline_profile, rs2_delete_pipeline_profile>;

Context new_context() { return Context(call(rs2_create_context, RS2_API_VERSION)); }

Handle<rs2_device_list, rs2_delete_device_list> devices_of(const rs2_context* context) {
  return Handle<rs2_device_list, rs2_delete_device_list>(call(rs2_query_devices, context));
}

/// Throws if the device is not there. A pipeline would wait for it instead.
void check_device(const rs2_context* context, const std::string& serial) {
  const auto devices = devices_of(context);
  for (int i = 0; i < call(rs2_get_device_count, devices.get()); ++i) {
    const Handle<rs2_device, rs2_delete_device> device(call(rs2_create_device, devices.get(), i));
    const char* found = call(rs2_get_device_info, device.get(), RS2_CAMERA_INFO_SERIAL_NUMBER);
    if (serial.empty() || serial == found) return;
  }
  throw DeviceError("realsense: no device" + (serial.empty() ? "" : " " + serial));
}

rs2_stream stream_of(const rs2_stream_profile* profile, rs2_format& format) {
  rs2_stream stream{};
  int index = 0, id = 0, rate = 0;
  call(rs2_get_stream_profile_data, profile, &stream, &format, &index, &id, &rate);
  return stream;
}

SdkImage image_of(const rs2_frame* frame, rs2_format format) {
  SdkImage image;
  image.rows = call(rs2_get_frame_height, frame);
  image.cols = call(rs2_get_frame_width, frame);
  image.row_bytes = call(rs2_get_frame_stride_in_bytes, frame);
  image.data = call(rs2_get_frame_data, frame);
  switch (format) {
    case RS2_FORMAT_Z16:
      image.pixels = SdkPixels::kDepth16;
      break;
    case RS2_FORMAT_RGB8:
      image.pixels = SdkPixels::kRgb;
      break;
    case RS2_FORMAT_BGR8:
      image.pixels = SdkPixels::kBgr;
      break;
    case RS2_FORMAT_RGBA8:
      image.pixels = SdkPixels::kRgbx;
      break;
    case RS2_FORMAT_BGRA8:
      image.pixels = SdkPixels::kBgrx;
      break;
    default:
      image.data = nullptr;
  }
  return image;
}

class RealSense final : public SdkDevice {
 public:
  RealSense(const SdkLocation& at, bool is_file)
      : context_(new_context()),
        pipeline_(call(rs2_create_pipeline, context_.get())),
        queue_(call(rs2_create_frame_queue, 1)),
        align_(call(rs2_create_align, RS2_STREAM_DEPTH)) {
    const Handle<rs2_config, rs2_delete_config> config(call(rs2_create_config));
    if (is_file) {
      call(rs2_config_enable_device_from_file_repeat_option, config.get(), at.place.c_str(), 0);
      const Profile found(call(rs2_config_resolve, config.get(), pipeline_.get()));
      file_.reset(call(rs2_pipeline_profile_get_device, found.get()));
      call(rs2_playback_device_set_real_time, file_.get(), 0);
    } else {
      check_device(context_.get(), at.place);
      if (!at.place.empty()) call(rs2_config_enable_device, config.get(), at.place.c_str());
      const int rate = at.options.at("rate");
      call(rs2_config_enable_stream, config.get(), RS2_STREAM_DEPTH, -1, at.options.at("width"),
           at.options.at("height"), RS2_FORMAT_Z16, rate);
      call(rs2_config_enable_stream, config.get(), RS2_STREAM_COLOR, -1, 0, 0, RS2_FORMAT_RGB8,
           rate);
      if (call(rs2_config_can_resolve, config.get(), pipeline_.get()) == 0) {
        // the device may have no colour camera
        call(rs2_config_disable_stream, config.get(), RS2_STREAM_COLOR);
      }
    }
    call(rs2_start_processing_queue, align_.get(), queue_.get());
    profile_.reset(call(rs2_pipeline_start_with_config, pipeline_.get(), config.get()));
  }
  ~RealSense() override {
    rs2_error* ignored = nullptr;
    if (profile_) rs2_pipeline_stop(pipeline_.get(), &ignored);
    if (ignored != nullptr) rs2_free_error(ignored);
  }

  [[nodiscard]] Intrinsics camera() const override {
    const Handle<rs2_stream_profile_list, rs2_delete_stream_profiles_list> streams(
        call(rs2_pipeline_profile_get_streams, profile_.get()));
    for (int i = 0; i < call(rs2_get_stream_profiles_count, streams.get()); ++i) {
      const rs2_stream_profile* profile = call(rs2_get_stream_profile, streams.get(), i);
      rs2_format format{};
      if (stream_of(profile, format) == RS2_STREAM_DEPTH) return camera_of(profile);
    }
    throw DeviceError("realsense: no depth");
  }

  ReadStatus wait(SdkFrame& frame, std::chrono::milliseconds timeout) override {
    rs2_frame* found = nullptr;
    if (call(rs2_pipeline_try_wait_for_frames, pipeline_.get(), &found,
             static_cast<unsigned>(timeout.count())) == 0) {
      return is_over() ? ReadStatus::kEnd : ReadStatus::kTimeout;
    }
    constexpr unsigned kMaxMs = 1000;
    call(rs2_process_frame, align_.get(), found);  // takes ownership of `found`
    const Frame images(call(rs2_wait_for_frame, queue_.get(), kMaxMs));
    for (int i = 0; i < call(rs2_embedded_frames_count, images.get()); ++i) {
      Frame image(call(rs2_extract_frame, images.get(), i));
      rs2_format format{};
      const rs2_stream stream = stream_of(call(rs2_get_frame_stream_profile, image.get()), format);
      if (stream == RS2_STREAM_COLOR) {
        frame.color = image_of(image.get(), format);
        color_ = std::move(image);
      } else if (stream == RS2_STREAM_DEPTH) {
        frame.depth = image_of(image.get(), format);
        frame.millimetres =
            1000.0 * static_cast<double>(call(rs2_depth_frame_get_units, image.get()));
        frame.number = static_cast<std::int64_t>(call(rs2_get_frame_number, image.get()));
        frame.time_ns = std::llround(1e6 * call(rs2_get_frame_timestamp, image.get()));
        depth_ = std::move(image);
      }
    }
    return ReadStatus::kFrame;
  }

 private:
  static Intrinsics camera_of(const rs2_stream_profile* profile) {
    rs2_intrinsics told{};
    call(rs2_get_video_stream_intrinsics, profile, &told);
    Intrinsics camera;
    camera.width = told.width;
    camera.height = told.height;
    camera.fx = told.fx;
    camera.fy = told.fy;
    camera.cx = told.ppx;
    camera.cy = told.ppy;
    std::copy_n(told.coeffs, 5, camera.distortion.begin());
    const bool is_straight = std::ranges::all_of(told.coeffs, [](float k) { return k == 0.0F; });
    if (!is_straight && told.model != RS2_DISTORTION_BROWN_CONRADY) {
      throw InputError(std::string("calibration: realsense: tells a lens of the kind ") +
                       rs2_distortion_to_string(told.model) + "; expected its camera");
    }
    return camera;
  }

  [[nodiscard]] bool is_over() const {
    return file_ &&
           call(rs2_playback_device_get_current_status, file_.get()) == RS2_PLAYBACK_STATUS_STOPPED;
  }

  Context context_;
  Handle<rs2_pipeline, rs2_delete_pipeline> pipeline_;
  Handle<rs2_device, rs2_delete_device> file_;
  Handle<rs2_frame_queue, rs2_delete_frame_queue> queue_;
  Handle<rs2_processing_block, rs2_delete_processing_block> align_;
  Profile profile_;
  Frame depth_, color_;
};

}  // namespace

std::unique_ptr<RgbdSource> open_realsense(const std::string& location,
                                           const RgbdOptions& options) {
  const SdkLocation at = parse_sdk_location("realsense", location, {"width", "height", "rate"});
  const bool is_file = at.place.ends_with(".bag");
  const auto open = [at, is_file] { return std::make_unique<RealSense>(at, is_file); };
  if (is_file) return open_sdk_file("realsense", at.place, open, options);
  return open_sdk_camera("realsense", open, options, kSdkSilence);
}

std::string realsense_absence() try {
  // Some versions (2.53) crash without USB instead of finding no device.
  if (!std::filesystem::exists("/sys/bus/usb/devices")) return "no device: there is no USB";
  const Context context = new_context();
  const auto devices = devices_of(context.get());
  return call(rs2_get_device_count, devices.get()) > 0 ? "" : "no device";
} catch (const DeviceError& error) {
  return error.what();
}

}  // namespace manip3d
