#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <string>

#include "ffmpeg.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/error.hpp"

extern "C" void av_log_set_level(int level);  // of libavutil

namespace {

using manip3d::RgbdFrame;

bool is_whole(const RgbdFrame& frame) {
  const manip3d::RgbdCalibration& calibration = *frame.calibration;
  const auto pixels = static_cast<std::size_t>(frame.rows * frame.cols);
  const auto colors = static_cast<std::size_t>(3 * frame.color_rows * frame.color_cols);
  return frame.rows == calibration.depth.height && frame.cols == calibration.depth.width &&
         frame.depth.size() == pixels && frame.color.size() == colors &&
         (frame.body_index.empty() || frame.body_index.size() == pixels);
}

}  // namespace

// Reads the bytes as a recording: complete frames, each of them counted, or a FormatError with a
// reason.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const int file = [] {
    ::av_log_set_level(-8);  // silent: FFmpeg's messages about damaged files are not findings
    manip3d::set_mkv_loader(
        [] { return manip3d::FoundMkvCodec{&manip3d::ffmpeg_mkv_codec(), "", ""}; });
    return ::memfd_create("recording", MFD_CLOEXEC);
  }();
  const std::string path = "/proc/self/fd/" + std::to_string(file);
  if (::ftruncate(file, 0) != 0 || ::pwrite(file, data, size, 0) != static_cast<ssize_t>(size)) {
    std::abort();
  }
  try {
    const auto source = manip3d::open_mkv(path);
    RgbdFrame frame;
    std::int64_t frames = 0;
    while (source->read(frame, {}) == manip3d::ReadStatus::kFrame) {
      if (!is_whole(frame)) std::abort();
      ++frames;
    }
    if (source->counters().front().second != frames) std::abort();
  } catch (const manip3d::FormatError& error) {
    if (error.reason().empty()) std::abort();
  }
  return 0;
}
