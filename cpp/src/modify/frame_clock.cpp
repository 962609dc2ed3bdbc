#include "modify/frame_clock.hpp"

#include <algorithm>
#include <limits>

namespace manip3d {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;  // nanoseconds

/// a - b, saturated to the range of 64-bit integers.
std::int64_t difference(std::int64_t a, std::int64_t b) {
  using Limits = std::numeric_limits<std::int64_t>;
  if (b < 0 && a > Limits::max() + b) return Limits::max();
  if (b > 0 && a < Limits::min() + b) return Limits::min();
  return a - b;
}

}  // namespace

FrameOrder FrameClock::add(std::int64_t time_ns, std::int64_t number) {
  const FrameOrder order = place(time_ns, number > last_number_);
  if (order != FrameOrder::kLate) last_number_ = number;
  return order;
}

/// @param is_later  Whether the frame has a higher number than the last one.
FrameOrder FrameClock::place(std::int64_t time_ns, bool is_later) {
  constexpr std::int64_t kMaxLate = 10;
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
  if (by_ns == 0 && is_later) {
    late_in_row_ = 0;
    share();
    return FrameOrder::kNext;
  }
  ++late_frames_;
  if (by_ns < -kSecond) {
    start(time_ns);
    return FrameOrder::kNewRecording;
  }
  if (++late_in_row_ <= kMaxLate) return FrameOrder::kLate;
  late_in_row_ = kMaxLate;
  advance(time_ns, kNominalPeriod);
  return FrameOrder::kNext;
}

void FrameClock::start(std::int64_t time_ns) {
  has_time_ = true;
  last_time_ns_ = time_ns;
  late_in_row_ = elapsed_ns_ = ahead_ns_ = 0;
  num_with_time_ = 1;
  period_ns_ = kNominalPeriod;
}

void FrameClock::advance(std::int64_t time_ns, std::int64_t by_ns) {
  // A longer gap counts as this; everything is forgotten after it.
  constexpr std::int64_t kLongest = 3600 * kSecond;
  constexpr std::int64_t kLeast = 1'000'000;  // nanoseconds; time always advances
  last_time_ns_ = time_ns;
  // If several frames shared the last time stamp, the distance to this one gives their period.
  if (num_with_time_ > 1) period_ns_ = std::min(by_ns / num_with_time_, kNominalPeriod);
  const std::int64_t left_ns = ahead_ns_ > 0 ? std::max(by_ns - ahead_ns_, kLeast) : by_ns;
  elapsed_ns_ += std::min(left_ns, kLongest);
  ahead_ns_ = 0;
  num_with_time_ = 1;
}

/// Adds one more frame with the last time stamp.
void FrameClock::share() {
  ++num_with_time_;
  ahead_ns_ += period_ns_;
  elapsed_ns_ += period_ns_;
}

}  // namespace manip3d
