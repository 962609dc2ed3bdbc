#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <map>
#include <memory>
#include <string>
#include <type_traits>

#include "manip3d/capture/rgbd_source.hpp"

/// @file
/// Common parts of the drivers that use makers' SDKs. A driver opens its device and delivers images
/// as the SDK has them; all other work is done here, so that it can be tested without a device.
namespace manip3d {

enum class SdkPixels : std::uint8_t {
  kDepth16,
  kDepthFloat,  ///< Values that are not > 0, or NaN: no measurement.
  kRgb,
  kBgr,
  kRgbx,
  kBgrx
};

struct SdkImage {
  const void* data = nullptr;  ///< Null: no such image.
  std::int64_t rows = 0, cols = 0;
  std::int64_t row_bytes = 0;
  SdkPixels pixels = SdkPixels::kDepth16;
};

struct SdkFrame {
  SdkImage depth;
  SdkImage color;            ///< Colour with the pixels of depth.
  double millimetres = 1.0;  ///< Millimetres per unit of depth.
  std::int64_t number = 0, time_ns = 0;
};

/// A streaming device, or a file that its SDK plays.
class SdkDevice {
 public:
  SdkDevice() = default;
  SdkDevice(const SdkDevice&) = delete;
  SdkDevice& operator=(const SdkDevice&) = delete;
  virtual ~SdkDevice() = default;

  /// The camera of the depth images, with `mirrored` set if these are mirrored.
  /// @throws InputError  Intrinsics cannot represent the lens.
  [[nodiscard]] virtual Intrinsics camera() const = 0;
  /// The images are valid until the next call.
  virtual ReadStatus wait(SdkFrame& frame, std::chrono::milliseconds timeout) = 0;
};

/// Location of a URI: `PLACE?option=number&...`.
struct SdkLocation {
  std::string place;
  std::map<std::string, int> options;  ///< All options of the scheme; 0: not given.
};

/// @throws InputError  an unknown option, or a value that is not a whole number > 0.
SdkLocation parse_sdk_location(const std::string& scheme, const std::string& location,
                               std::initializer_list<const char*> options);

using SdkOpener = std::function<std::unique_ptr<SdkDevice>()>;

/// Opens a camera, which is read by a thread of its own. A camera without images for `silence`
/// counts as unplugged. Counters: `frames`, `lost_by_camera` (gaps in the frame numbers),
/// `without_color`, `damaged` (images of another size or kind than the camera's). The registration
/// of a given calibration is ignored: colour comes with the pixels of depth.
std::unique_ptr<RgbdSource> open_sdk_camera(const std::string& scheme, SdkOpener open,
                                            const RgbdOptions& options,
                                            std::chrono::milliseconds silence);
inline constexpr std::chrono::milliseconds kSdkSilence(5000);  // some cameras take 2 s to start

/// Opens a file, which gives all its frames or plays in real time (options.speed).
/// @throws std::filesystem::filesystem_error  the file does not exist.
std::unique_ptr<RgbdSource> open_sdk_file(const std::string& scheme,
                                          const std::filesystem::path& path, SdkOpener open,
                                          const RgbdOptions& options);

/// Calls a C function of an SDK that stores its error in its last argument; `raise` throws errors
/// that are not null.
template <typename Error, typename Function, typename... Arguments>
auto sdk_call(void (*raise)(Error*), Function function, Arguments... arguments) {
  Error* error = nullptr;
  if constexpr (std::is_void_v<std::invoke_result_t<Function, Arguments..., Error**>>) {
    function(arguments..., &error);
    raise(error);
  } else {
    const auto result = function(arguments..., &error);
    raise(error);
    return result;
  }
}

}  // namespace manip3d
