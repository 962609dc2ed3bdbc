#include "manip3d/capture/rgbd_source.hpp"

#include <cmath>
#include <string>

#include "manip3d/capture/folder.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

RgbdScheme mkv_scheme() {
  RgbdScheme scheme{"mkv", "FILE", "recordings of this library and of Azure Kinect (Matroska)",
                    {},    "",     ""};
#ifdef MANIP3D_FFMPEG
  scheme.open = open_mkv;
  scheme.reason = mkv_absence();
  if (!scheme.reason.empty()) scheme.cure = "apt-get install libavformat59";
#else
  scheme.reason = "not built: FFmpeg's development files were not found";
  scheme.cure = "apt-get install libavformat-dev libavcodec-dev libavutil-dev, then build again";
#endif
  return scheme;
}

}  // namespace

std::vector<RgbdScheme> rgbd_schemes() {
  return {
      {"folder", "FOLDER", "recordings as folders of images; any folder with depth/ and color/",
       open_folder, "", ""},
      {"tum", "FOLDER", "sequences of the TUM RGB-D benchmark (depth.txt, rgb.txt)", open_tum, "",
       ""},
      mkv_scheme(),
  };
}

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
  for (const RgbdScheme& scheme : rgbd_schemes()) {
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
