#include "manip3d/capture/rgbd_source.hpp"

#include <cmath>
#include <string>

#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/capture/openni2.hpp"
#include "manip3d/capture/sdk_cameras.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Frames per second of folders without times. No depth camera is faster; times of a slower one
// would not fit in 64 bits for long folders.
constexpr double kLeastRate = 0.01, kMostRate = 1000.0;

RgbdScheme mkv_scheme(bool probe) {
  RgbdScheme scheme{"mkv",    "FILE", "recordings of this library and of Azure Kinect (Matroska)",
                    open_mkv, "",     ""};
  if (!probe) return scheme;
  const FoundMkvCodec found = find_mkv_codec();
  scheme.reason = found.reason;
  scheme.cure = found.cure;
  return scheme;
}

/// The functions of a driver; null if it was not built in.
struct Driver {
  std::unique_ptr<RgbdSource> (*open)(const std::string&, const RgbdOptions&) = nullptr;
  std::string (*absence)() = nullptr;
};
#ifdef MANIP3D_OPENNI2
constexpr Driver kOpenNi2{open_openni2, openni2_absence};
#else
constexpr Driver kOpenNi2;
#endif
#ifdef MANIP3D_FREENECT2
constexpr Driver kFreenect2{open_freenect2, freenect2_absence};
#else
constexpr Driver kFreenect2;
#endif
#ifdef MANIP3D_REALSENSE
constexpr Driver kRealSense{open_realsense, realsense_absence};
#else
constexpr Driver kRealSense;
#endif
#ifdef MANIP3D_ORBBEC
constexpr Driver kOrbbec{open_orbbec, orbbec_absence};
#else
constexpr Driver kOrbbec;
#endif

/// @param scheme  with the cure for a missing device.
/// @param library  the library that is needed to build the driver.
RgbdScheme driven(RgbdScheme scheme, const Driver& driver, bool probe, const char* library) {
  if (driver.open == nullptr) {
    scheme.reason = std::string("not built: ") + library + " was not found";
    scheme.cure = std::string("install ") + library + ", then build again";
    return scheme;
  }
  scheme.open = driver.open;
  if (probe) scheme.reason = driver.absence();
  if (scheme.reason.empty()) scheme.cure.clear();
  return scheme;
}

/// @param probe  search for libraries and devices of the drivers that were built in.
std::vector<RgbdScheme> schemes(bool probe) {
  return {
      {"folder", "FOLDER", "recordings as folders of images; any folder with depth/ and color/",
       open_folder, "", ""},
      {"tum", "FOLDER", "sequences of the TUM RGB-D benchmark (depth.txt, rgb.txt)", open_tum, "",
       ""},
      mkv_scheme(probe),
      driven({"openni2",
              "[URI]",
              "cameras that OpenNI2 drives: Kinect V1, Xtion, Astra",
              {},
              "",
              "plug one in; openni2:Dummy needs none"},
             kOpenNi2, probe, "OpenNI2 (apt-get install libopenni2-dev)"),
      driven({"freenect2", "[SERIAL]", "Kinect V2, by libfreenect2", {}, "", "plug one in"},
             kFreenect2, probe, "libfreenect2 0.2"),
      driven({"realsense",
              "[SERIAL] or FILE.bag",
              "Intel RealSense, by librealsense2",
              {},
              "",
              "plug one in; realsense:FILE.bag needs none"},
             kRealSense, probe, "librealsense2 2.53 or later"),
      driven({"orbbec",
              "[SERIAL] or FILE.bag",
              "Orbbec cameras, by OrbbecSDK 2",
              {},
              "",
              "plug one in; orbbec:FILE.bag needs none"},
             kOrbbec, probe, "OrbbecSDK 2"),
  };
}

}  // namespace

void RgbdSource::seek(std::int64_t) {
  throw InputError("source: expected a recording, whose frames have an index; a camera has none");
}

void RgbdSource::read_at(std::int64_t index, RgbdFrame& frame) {
  seek(index);
  if (read(frame, std::chrono::milliseconds(0)) == ReadStatus::kFrame) return;
  throw InputError("index: expected that of a frame, got " + std::to_string(index));
}

void check_frame_index(std::int64_t index) {
  if (index >= 0) return;
  throw InputError("index: expected >= 0, got " + std::to_string(index));
}

std::vector<RgbdScheme> rgbd_schemes() { return schemes(true); }

std::unique_ptr<RgbdSource> open_rgbd(const std::string& uri, const RgbdOptions& options) {
  if (!(options.speed >= 0.0 && std::isfinite(options.speed))) {
    throw InputError("speed: expected a finite number >= 0, got " + number_text(options.speed));
  }
  if (!(options.units_per_metre >= 0.0 && std::isfinite(options.units_per_metre))) {
    throw InputError("units_per_metre: expected a finite number >= 0, got " +
                     number_text(options.units_per_metre));
  }
  if (options.rate != 0.0 && !(options.rate >= kLeastRate && options.rate <= kMostRate)) {
    throw InputError("rate: expected 0.01 to 1000 frames per second, got " +
                     number_text(options.rate));
  }
  const std::size_t colon = uri.find(':');
  std::string known;
  for (const RgbdScheme& scheme : schemes(false)) {
    known += (known.empty() ? "" : ", ") + scheme.name + ":";
    if (colon == std::string::npos || uri.substr(0, colon) != scheme.name) continue;
    if (!scheme.open) {
      throw DeviceError(scheme.name + ": " + scheme.reason + " (" + scheme.cure + ")");
    }
    return scheme.open(uri.substr(colon + 1), options);
  }
  throw InputError("uri: expected one of " + known + " and a place, got '" + uri + "'");
}

}  // namespace manip3d
