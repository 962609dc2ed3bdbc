#pragma once

#include <chrono>
#include <cstdint>

/// @file
/// What every sensor, recording and simulator looks like to whoever pulls frames out of it.
namespace manip3d {

enum class ReadStatus : std::uint8_t {
  kFrame,    ///< There is a frame.
  kTimeout,  ///< No frame came in time; try again.
  kEnd       ///< No frame will come any more.
};

struct SourceCapabilities {
  /// Frames come when the sensor has them; what is not read in time is lost.
  bool is_live = false;
};

/// Frames one after the other. A live source collects in a thread of its own between `start` and
/// `stop`; the others work when they are read. Errors of files are thrown by `read`.
template <typename Frame>
class FrameSource {
 public:
  FrameSource() = default;
  FrameSource(const FrameSource&) = delete;
  FrameSource& operator=(const FrameSource&) = delete;
  virtual ~FrameSource() = default;

  [[nodiscard]] virtual SourceCapabilities capabilities() const = 0;
  /// Begins; a live source collects from now on.
  virtual void start() = 0;
  /// Moves the next frame into `frame`. Waits at most `timeout`, and at most an hour, for a live
  /// source.
  virtual ReadStatus read(Frame& frame, std::chrono::milliseconds timeout) = 0;
  /// Ends a live source's thread. What was collected before can still be read.
  virtual void stop() = 0;
};

}  // namespace manip3d
