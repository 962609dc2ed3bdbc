#include "modify/frame_clock.hpp"

#include <algorithm>
#include <limits>

namespace manip3d {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;  // nanoseconds
constexpr std::int64_t kNominalPeriod = 33'333'333;

/// a - b, or the nearest number there is.
std::int64_t difference(std::int64_t a, std::int64_t b) {
  using Limits = std::numeric_limits<std::int64_t>;
  if (b < 0 && a > Limits::max() + b) return Limits::max();
  if (b > 0 && a < Limits::min() + b) return Limits::min();
  return a - b;
}

}  // namespace

FrameOrder FrameClock::add(std::int64_t time_ns) {
  constexpr std::int64_t kMostLate = 10;
  if (!has_time_) {
    start(time_ns);
    return FrameOrder::kNext;
  }
  const std::int64_t by_ns = difference(time_ns, last_time_ns_);
  if (by_ns > 0) {
    late_in_row_ = 0;
    advance(time_ns, by_ns);
    return FrameOrder::kNext;
  }
  const bool has_clock = time_ns != 0 || last_time_ns_ != 0;
  if (!has_clock) {
    advance(0, kNominalPeriod);
    return FrameOrder::kNext;
  }
  ++late_frames_;
  if (by_ns < -kSecond) {
    start(time_ns);
    return FrameOrder::kNewRecording;
  }
  if (++late_in_row_ <= kMostLate) return FrameOrder::kLate;
  late_in_row_ = kMostLate;
  advance(time_ns, kNominalPeriod);
  return FrameOrder::kNext;
}

void FrameClock::start(std::int64_t time_ns) {
  has_time_ = true;
  last_time_ns_ = time_ns;
  late_in_row_ = elapsed_ns_ = 0;
}

void FrameClock::advance(std::int64_t time_ns, std::int64_t by_ns) {
  constexpr std::int64_t kLongest = 3600 * kSecond;  // all is forgotten
  last_time_ns_ = time_ns;
  elapsed_ns_ += std::min(by_ns, kLongest);
}

}  // namespace manip3d
