#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "manip3d/capture/velodyne.hpp"
#include "manip3d/error.hpp"

namespace {

using manip3d::VelodyneDecoder;
using manip3d::VelodyneFrame;

// Checks that each column has a value per point, and that packets can contain these values.
void check(const VelodyneFrame& frame) {
  const std::size_t n = frame.intensity.size();
  const bool same = frame.points.size() == 3 * n && frame.ring.size() == n &&
                    frame.laser.size() == n && frame.return_type.size() == n &&
                    frame.azimuth.size() == n && frame.range.size() == n && frame.time.size() == n;
  if (!same) std::abort();
  for (std::size_t i = 0; i < n; ++i) {
    const bool sane = frame.azimuth[i] >= 0.0F && frame.azimuth[i] < 360.0F &&
                      frame.range[i] > 0.0F && frame.range[i] < 263.0F && frame.ring[i] < 64 &&
                      frame.laser[i] < 64 && frame.return_type[i] <= 3 &&
                      std::fabs(frame.points[3 * i]) < 270.0F && std::isfinite(frame.time[i]);
    if (!sane) std::abort();
  }
}

manip3d::VelodyneOptions options_of(std::uint8_t choice) {
  manip3d::VelodyneOptions options;
  options.cut_azimuth_deg = choice % 4 * 90.0;
  options.max_points_per_frame = 2000;
  if (choice % 8 >= 4) {  // an HDL-64E needs a calibration
    options.calibration.lasers.resize(64, {1.0, 2.0, 0.1, choice % 2 == 1, 0.1, 0.1, 0.2, 0.02});
  }
  return options;
}

}  // namespace

// The first byte chooses the options. The rest is cut into packets of 1206 bytes and a remainder.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  VelodyneDecoder decoder(options_of(data[0]));
  std::int64_t points = 0;
  const auto take_all = [&] {
    VelodyneFrame frame;
    while (decoder.take(frame)) {
      check(frame);
      points += frame.num_points();
    }
  };
  try {
    for (std::size_t at = 1; at < size; at += manip3d::kVelodynePacketBytes) {
      const std::size_t length = std::min(size - at, manip3d::kVelodynePacketBytes);
      decoder.decode(std::as_bytes(std::span(data + at, length)), 0);
      take_all();
    }
  } catch (const manip3d::InputError&) {   // the calibration has lasers of another model
  } catch (const manip3d::FormatError&) {  // the first packet is a VLS-128's
  }
  decoder.flush();
  take_all();
  const manip3d::VelodyneCounters& c = decoder.counters();
  const std::int64_t firings = c.points + c.no_return + c.duplicates + c.out_of_range;
  if (points != c.points || firings % 32 != 0) std::abort();
  return 0;
}
