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
/// What the drivers of makers' SDKs share. A driver opens its device and hands over images as the
/// SDK has them; all the rest is done here, and tried without a device.
namespace manip3d {

enum class SdkPixels : std::uint8_t {
  kDepth16,
  kDepthFloat,  ///< Not > 0, NaN: no measurement.
  kRgb,
  kBgr,
  kRgbx,
  kBgrx
};

struct SdkImage {
  const void* data = nullptr;  ///< None: there is no such image.
  std::int64_t rows = 0, cols = 0;
  std::int64_t row_bytes = 0;
  SdkPixels pixels = SdkPixels::kDepth16;
};

struct SdkFrame {
  SdkImage depth;
  SdkImage color;            ///< With the pixels of depth.
  double millimetres = 1.0;  ///< One unit of depth.
  std::int64_t number = 0, time_ns = 0;
};

/// A device while it streams, or a file that its SDK plays.
class SdkDevice {
 public:
  SdkDevice() = default;
  SdkDevice(const SdkDevice&) = delete;
  SdkDevice& operator=(const SdkDevice&) = delete;
  virtual ~SdkDevice() = default;

  /// The camera of the depth images; `mirrored` as they come.
  /// @throws InputError  a lens that has no place in Intrinsics.
  [[nodiscard]] virtual Intrinsics camera() const = 0;
  /// The images are good until the next call.
  virtual ReadStatus wait(SdkFrame& frame, std::chrono::milliseconds timeout) = 0;
};

/// `PLACE?option=number&...` of a URI.
struct SdkLocation {
  std::string place;
  std::map<std::string, int> options;  ///< All that there may be; 0: it was not given.
};

/// @throws InputError  an unknown option, no whole number > 0.
SdkLocation parse_sdk_location(const std::string& scheme, const std::string& location,
                               std::initializer_list<const char*> options);

using SdkOpener = std::function<std::unique_ptr<SdkDevice>()>;

/// A camera gives its latest frames, from a thread of its own; one that gives none for kSdkSilence
/// is taken as unplugged. Counters: `frames`, `lost_by_camera` (gaps in their numbers),
/// `without_color`, `damaged` (images of another size or kind than the camera's).
std::unique_ptr<RgbdSource> open_sdk_camera(const std::string& scheme, SdkOpener open,
                                            const RgbdOptions& options,
                                            std::chrono::milliseconds silence);
inline constexpr std::chrono::milliseconds kSdkSilence(5000);  // some take two to start

/// A file gives all its frames, or plays in real time.
/// @throws std::filesystem::filesystem_error  it is not there.
std::unique_ptr<RgbdSource> open_sdk_file(const std::string& scheme,
                                          const std::filesystem::path& path, SdkOpener open,
                                          const RgbdOptions& options);

/// Calls a function of an SDK in C, which puts its complaint where its last argument says; `raise`
/// throws what is not null.
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
