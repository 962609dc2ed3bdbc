#pragma once

#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "manip3d/capture/rgbd_source.hpp"

namespace manip3d {

/// Reads a camera in a thread of its own and keeps its latest frame for the reader.
///
/// There are two slots: the thread fills one while the other one waits to be read. A frame that was
/// not read before the next one is complete is lost and counted as `dropped`. `grabbed_ns` is the
/// time at which the camera delivered the frame, however long it waited. Exceptions of the thread
/// are thrown by `read`, after the frame that came before them; `start` then tries again.
class GrabThread final : public RgbdSource {
 public:
  explicit GrabThread(std::unique_ptr<RgbdSource> camera);
  ~GrabThread() override { stop(); }

  [[nodiscard]] SourceCapabilities capabilities() const override { return {true}; }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override;
  /// The camera's counters as of its last frame, and `dropped`.
  [[nodiscard]] Counters counters() const override;
  [[nodiscard]] std::optional<std::int64_t> num_frames() const override { return num_frames_; }
  [[nodiscard]] Conversions conversions() const override { return conversions_; }
  void seek(std::int64_t index) override;
  void start() override;
  ReadStatus read(RgbdFrame& frame, std::chrono::milliseconds timeout) override;
  /// A waiting frame can still be read afterwards. `start` and `stop` may be called from any
  /// thread, also during `read`, whose wait `stop` ends.
  void stop() override;

 private:
  void grab();
  void grab_frames();
  void publish();

  std::unique_ptr<RgbdSource> camera_;  // used by the thread while it runs
  std::optional<std::int64_t> num_frames_;
  Conversions conversions_;
  RgbdFrame filling_;      // used by the thread only
  std::mutex start_stop_;  // one `start` or `stop` at a time; locked before mutex_
  std::thread thread_;
  mutable std::mutex mutex_;  // guards the members below
  std::condition_variable changed_;
  RgbdFrame waiting_;
  bool is_waiting_ = false;
  bool is_running_ = false, is_stopping_ = false;
  std::exception_ptr error_;
  std::int64_t dropped_ = 0;
  Counters camera_counters_;
  std::shared_ptr<const RgbdCalibration> calibration_;
};

/// Plays a recording in real time, like a camera: each frame becomes available at its time, and
/// slow readers get the latest one.
/// @param speed  Playback speed; 1: by the frames' times, 2: twice as fast.
/// @throws InputError  speed is not > 0.
std::unique_ptr<RgbdSource> in_real_time(std::unique_ptr<RgbdSource> recording, double speed);

}  // namespace manip3d
