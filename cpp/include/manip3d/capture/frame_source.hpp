#pragma once

#include <chrono>
#include <cstdint>

/// @file
/// The interface of all sources of frames: sensors, recordings and simulators.
namespace manip3d {

enum class ReadStatus : std::uint8_t {
  kFrame,    ///< A frame was read.
  kTimeout,  ///< No frame came within the timeout; try again.
  kEnd       ///< No more frames will come.
};

struct SourceCapabilities {
  /// The sensor sets the pace, and frames that are not read in time are lost.
  bool is_live = false;
};

/// A sequence of frames. A live source collects frames in a thread of its own between `start` and
/// `stop`; other sources work within `read`. Errors of files are thrown by `read`.
template <typename Frame>
class FrameSource {
 public:
  FrameSource() = default;
  FrameSource(const FrameSource&) = delete;
  FrameSource& operator=(const FrameSource&) = delete;
  virtual ~FrameSource() = default;

  [[nodiscard]] virtual SourceCapabilities capabilities() const = 0;
  /// Starts the source; a live source collects frames from now on.
  virtual void start() = 0;
  /// Moves the next frame into `frame`. A live source waits for it at most `timeout`, and at most
  /// an hour.
  virtual ReadStatus read(Frame& frame, std::chrono::milliseconds timeout) = 0;
  /// Ends a live source's thread. Frames that were collected before can still be read.
  virtual void stop() = 0;
};

}  // namespace manip3d
