#pragma once

#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "manip3d/capture/rgbd_source.hpp"

namespace manip3d {

/// Reads a camera in a thread of its own and keeps the latest frame for whoever reads this one.
///
/// Two slots: the thread fills one while the other waits to be read; a frame that nobody has read
/// when the next one is complete is lost, and counted as `dropped`. Frames carry the time at which
/// the camera gave them (`grabbed_ns`), however long they wait. What the thread throws is
/// thrown by `read`, after the frame that came before it; then `start` tries again.
class GrabThread final : public RgbdSource {
 public:
  explicit GrabThread(std::unique_ptr<RgbdSource> camera);
  ~GrabThread() override { stop(); }

  [[nodiscard]] SourceCapabilities capabilities() const override { return {true}; }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override;
  /// The camera's, as of its last frame, and `dropped`.
  [[nodiscard]] Counters counters() const override;
  [[nodiscard]] std::optional<std::int64_t> num_frames() const override { return num_frames_; }
  void seek(std::int64_t index) override;
  void start() override;
  ReadStatus read(RgbdFrame& frame, std::chrono::milliseconds timeout) override;
  /// The frame that waits can still be read. `start` and `stop` may be called from any threads at
  /// the same time, also beside `read`, whose wait `stop` ends.
  void stop() override;

 private:
  void grab();
  void publish();

  std::unique_ptr<RgbdSource> camera_;  // the thread's while it runs
  std::optional<std::int64_t> num_frames_;
  RgbdFrame filling_;      // the thread's
  std::mutex start_stop_;  // one of them at a time; taken before mutex_
  std::thread thread_;
  mutable std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  RgbdFrame waiting_;
  bool is_waiting_ = false;
  bool is_running_ = false, is_stopping_ = false;
  std::exception_ptr error_;
  std::int64_t dropped_ = 0;
  Counters camera_counters_;
  std::shared_ptr<const RgbdCalibration> calibration_;
};

/// The frames of a recording as a camera would give them: each when its time has come, the latest
/// one for slow readers.
/// @param speed  1: by the frames' times; 2: twice as fast. @throws InputError  not > 0.
std::unique_ptr<RgbdSource> in_real_time(std::unique_ptr<RgbdSource> recording, double speed);

}  // namespace manip3d
