#include "manip3d/capture/rgbd_source.hpp"

#include <cmath>
#include <string>

#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/capture/openni2.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

RgbdScheme mkv_scheme(bool probe) {
  RgbdScheme scheme{"mkv", "FILE", "recordings of this library and of Azure Kinect (Matroska)",
                    {},    "",     ""};
#ifdef MANIP3D_FFMPEG
  scheme.open = open_mkv;
  if (probe) scheme.reason = mkv_absence();
  if (!scheme.reason.empty()) scheme.cure = kMkvCure;
#else
  static_cast<void>(probe);
  scheme.reason = "not built: FFmpeg's development files were not found";
  scheme.cure = "apt-get install libavformat-dev libavcodec-dev libavutil-dev, then build again";
#endif
  return scheme;
}

RgbdScheme openni2_scheme(bool probe) {
  RgbdScheme scheme{"openni2", "[URI]", "cameras that OpenNI2 drives: Kinect V1, Xtion, Astra",
                    {},        "",      ""};
#ifdef MANIP3D_OPENNI2
  scheme.open = open_openni2;
  if (probe) scheme.reason = openni2_absence();
  if (!scheme.reason.empty()) scheme.cure = "plug one in; openni2:Dummy needs none";
#else
  static_cast<void>(probe);
  scheme.reason = "not built: OpenNI2's development files were not found";
  scheme.cure = "apt-get install libopenni2-dev, then build again";
#endif
  return scheme;
}

/// Cameras that nobody here could try a driver with.
RgbdScheme unwritten_scheme(const char* name, const char* description) {
  return {name,
          "[SERIAL]",
          description,
          {},
          "no driver for it is written yet",
          "record with its own tools: mkv: and folder: read recordings"};
}

/// @param probe  look whether what was built in finds its libraries and devices.
std::vector<RgbdScheme> schemes(bool probe) {
  return {
      {"folder", "FOLDER", "recordings as folders of images; any folder with depth/ and color/",
       open_folder, "", ""},
      {"tum", "FOLDER", "sequences of the TUM RGB-D benchmark (depth.txt, rgb.txt)", open_tum, "",
       ""},
      mkv_scheme(probe),
      openni2_scheme(probe),
      unwritten_scheme("freenect2", "Kinect V2, by libfreenect2"),
      unwritten_scheme("realsense", "Intel RealSense, by librealsense2"),
      unwritten_scheme("orbbec", "Orbbec cameras, by their SDK"),
  };
}

}  // namespace

std::vector<RgbdScheme> rgbd_schemes() { return schemes(true); }

std::unique_ptr<RgbdSource> open_rgbd(const std::string& uri, const RgbdOptions& options) {
  if (!(options.speed >= 0.0 && std::isfinite(options.speed))) {
    throw InputError("speed: expected a finite number >= 0, got " + std::to_string(options.speed));
  }
  if (!(options.units_per_metre >= 0.0 && std::isfinite(options.units_per_metre))) {
    throw InputError("units_per_metre: expected a finite number >= 0, got " +
                     std::to_string(options.units_per_metre));
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
