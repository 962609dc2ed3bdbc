#pragma once

#include <cstdint>

namespace manip3d {

enum class FrameOrder : std::uint8_t {
  kNext,         ///< Newer than the last one, or the first of all.
  kLate,         ///< Not newer: to be passed over.
  kNewRecording  ///< More than a second older: the first of another recording.
};

/// The time of frames since the first one, by the source's clock or a nominal one.
///
/// A source may stamp several frames with one time, and number them on. Each of them comes a
/// thirtieth of a second after the one before, or sooner if the last frames with one time did so.
/// The next time that is newer makes up for it.
///
/// Frames that are older, or have the last one's time and no later number, are late, unless there
/// are more than ten of them in a row: then the source's clock stands or runs back, and frames
/// count as 30 a second until times grow again. A source whose times are all 0 has no clock.
class FrameClock {
 public:
  FrameOrder add(std::int64_t time_ns, std::int64_t number);
  [[nodiscard]] double seconds() const { return 1e-9 * static_cast<double>(elapsed_ns_); }
  /// Late frames since the first one or the last reset.
  [[nodiscard]] std::int64_t late_frames() const { return late_frames_; }
  void reset() { *this = {}; }

 private:
  FrameOrder place(std::int64_t time_ns, bool is_later);
  void start(std::int64_t time_ns);
  void advance(std::int64_t time_ns, std::int64_t by_ns);
  void share();

  static constexpr std::int64_t kNominalPeriod = 33'333'333;  // nanoseconds

  bool has_time_ = false;
  std::int64_t last_time_ns_ = 0, last_number_ = 0, elapsed_ns_ = 0;
  std::int64_t num_with_time_ = 1;           ///< Frames that had the last time.
  std::int64_t period_ns_ = kNominalPeriod;  ///< Between frames that have one time.
  std::int64_t ahead_ns_ = 0;                ///< How far they have come beyond that time.
  std::int64_t late_frames_ = 0, late_in_row_ = 0;
};

}  // namespace manip3d
