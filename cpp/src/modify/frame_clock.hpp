#pragma once

#include <cstdint>

namespace manip3d {

enum class FrameOrder : std::uint8_t {
  kNext,         ///< Newer than the last one, or the first of all.
  kLate,         ///< Not newer; it is to be skipped.
  kNewRecording  ///< More than a second older: the first of another recording.
};

/// Time of frames since the first one, from the source's clock or from a nominal one.
///
/// A source may give several frames the same time stamp but increasing numbers. Each of them counts
/// as a thirtieth of a second after the one before, or less if the previous frames with a common
/// time stamp had a shorter period. The next newer time stamp corrects the sum.
///
/// Frames are late if their time stamp is older, or if it is equal and their number is not higher.
/// From the eleventh late frame in a row on, the source's clock is stopped or running backwards,
/// and frames count as 30 a second until times increase again. A source whose times are all 0 has
/// no clock.
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
  std::int64_t num_with_time_ = 1;           ///< Frames with the last time stamp.
  std::int64_t period_ns_ = kNominalPeriod;  ///< Time between frames with one time stamp.
  std::int64_t ahead_ns_ = 0;  ///< Time by which these frames are ahead of that time stamp.
  std::int64_t late_frames_ = 0, late_in_row_ = 0;
};

}  // namespace manip3d
