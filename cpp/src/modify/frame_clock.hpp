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
/// Frames that are not newer are late, unless there are more than ten of them in a row: then the
/// source's clock stands or runs back, and frames count as 30 a second until times grow again. A
/// source whose times are all 0 has no clock.
class FrameClock {
 public:
  FrameOrder add(std::int64_t time_ns);
  [[nodiscard]] double seconds() const { return 1e-9 * static_cast<double>(elapsed_ns_); }
  /// Late frames since the first one or the last reset.
  [[nodiscard]] std::int64_t late_frames() const { return late_frames_; }
  void reset() { *this = {}; }

 private:
  void start(std::int64_t time_ns);
  void advance(std::int64_t time_ns, std::int64_t by_ns);

  bool has_time_ = false;
  std::int64_t last_time_ns_ = 0, elapsed_ns_ = 0;
  std::int64_t late_frames_ = 0, late_in_row_ = 0;
};

}  // namespace manip3d
