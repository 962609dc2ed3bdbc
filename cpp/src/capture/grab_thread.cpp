#include "manip3d/capture/grab_thread.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "capture/longest_wait.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kPoll(50);  // longest wait of `stop` for a camera without frames

/// Nanoseconds since 1970 by this machine's clock.
std::int64_t now_ns() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
}

/// Delays each frame until its time.
class Paced final : public RgbdSource {
 public:
  Paced(std::unique_ptr<RgbdSource> recording, double speed)
      : recording_(std::move(recording)), speed_(speed) {}

  [[nodiscard]] SourceCapabilities capabilities() const override {
    return recording_->capabilities();
  }
  [[nodiscard]] std::shared_ptr<const RgbdCalibration> calibration() const override {
    return recording_->calibration();
  }
  [[nodiscard]] Counters counters() const override { return recording_->counters(); }
  [[nodiscard]] Conversions conversions() const override { return recording_->conversions(); }
  [[nodiscard]] std::optional<std::int64_t> num_frames() const override {
    return recording_->num_frames();
  }
  void start() override {
    recording_->start();
    has_begun_ = false;  // the time between stop and start is none of the recording's
    if (is_held_) hold();
  }
  void stop() override { recording_->stop(); }

  void seek(std::int64_t index) override {
    recording_->seek(index);
    is_held_ = has_begun_ = false;
  }

  ReadStatus read(RgbdFrame& frame, milliseconds timeout) override {
    const auto deadline = Clock::now() + std::clamp(timeout, milliseconds(0), kLongestWait);
    if (!is_held_) {
      const ReadStatus status = recording_->read(held_, timeout);
      if (status != ReadStatus::kFrame) return status;
      is_held_ = true;
      hold();
    }
    std::this_thread::sleep_until(std::min(due_time_, deadline));
    if (due_time_ > deadline) return ReadStatus::kTimeout;
    std::swap(frame, held_);
    is_held_ = false;
    return ReadStatus::kFrame;
  }

 private:
  void hold() {
    if (!has_begun_) {
      has_begun_ = true;
      begin_time_ = Clock::now();
      first_ns_ = held_.time_ns;
    }
    constexpr double kLongest = 3e16;  // a year: its sum with the clock's time fits 64 bits
    const double after =
        (static_cast<double>(held_.time_ns) - static_cast<double>(first_ns_)) / speed_;
    const auto after_ns = static_cast<std::int64_t>(std::clamp(after, 0.0, kLongest));
    due_time_ = begin_time_ + std::chrono::nanoseconds(after_ns);
  }

  std::unique_ptr<RgbdSource> recording_;
  double speed_;
  RgbdFrame held_;
  bool is_held_ = false;    // held_ was read and is not delivered yet
  bool has_begun_ = false;  // begin_time_ and first_ns_ are of the first frame since the start
  std::int64_t first_ns_ = 0;
  Clock::time_point begin_time_, due_time_;
};

}  // namespace

GrabThread::GrabThread(std::unique_ptr<RgbdSource> camera)
    : camera_(std::move(camera)),
      num_frames_(camera_->num_frames()),
      conversions_(camera_->conversions()),
      camera_counters_(camera_->counters()),
      calibration_(camera_->calibration()) {}

std::shared_ptr<const RgbdCalibration> GrabThread::calibration() const {
  const std::lock_guard lock(mutex_);
  return calibration_;
}

Counters GrabThread::counters() const {
  const std::lock_guard lock(mutex_);
  Counters counters = camera_counters_;
  counters.emplace_back("dropped", dropped_);
  return counters;
}

void GrabThread::seek(std::int64_t index) {
  const std::lock_guard turn(start_stop_);
  if (thread_.joinable()) throw InputError("source: expected one that does not play yet");
  camera_->seek(index);
  const std::lock_guard lock(mutex_);
  is_waiting_ = false;  // the waiting frame is of another position
}

void GrabThread::start() {
  const std::lock_guard turn(start_stop_);
  {
    const std::lock_guard lock(mutex_);
    if (is_running_) return;
  }
  if (thread_.joinable()) thread_.join();  // the thread has ended with an error
  camera_->start();
  const std::lock_guard lock(mutex_);
  error_ = nullptr;
  is_stopping_ = false;
  try {
    calibration_ = camera_->calibration();
    thread_ = std::thread(&GrabThread::grab, this);
  } catch (...) {  // without a thread, the camera must not stay open
    camera_->stop();
    throw;
  }
  is_running_ = true;
}

void GrabThread::stop() {
  const std::lock_guard turn(start_stop_);
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  if (thread_.joinable()) {
    thread_.join();
    camera_->stop();
  }
}

void GrabThread::grab() {
  std::exception_ptr error;
  try {
    grab_frames();
  } catch (...) {
    error = std::current_exception();
  }
  const std::lock_guard lock(mutex_);
  try {  // the camera may also have counted after its last frame
    camera_counters_ = camera_->counters();
  } catch (...) {
    if (!error) error = std::current_exception();
  }
  error_ = error;
  is_running_ = false;
  changed_.notify_all();
}

void GrabThread::grab_frames() {
  ReadStatus status = ReadStatus::kTimeout;
  while (status != ReadStatus::kEnd) {
    {
      const std::lock_guard lock(mutex_);
      if (is_stopping_) return;
    }
    status = camera_->read(filling_, kPoll);
    if (status != ReadStatus::kFrame) continue;
    filling_.grabbed_ns = now_ns();
    publish();
  }
}

void GrabThread::publish() {
  const std::lock_guard lock(mutex_);
  std::swap(waiting_, filling_);
  dropped_ += is_waiting_ ? 1 : 0;
  is_waiting_ = true;
  camera_counters_ = camera_->counters();
  changed_.notify_one();
}

ReadStatus GrabThread::read(RgbdFrame& frame, milliseconds timeout) {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, std::min(timeout, kLongestWait),
                    [this] { return is_waiting_ || !is_running_; });
  if (is_waiting_) {
    std::swap(frame, waiting_);
    is_waiting_ = false;
    return ReadStatus::kFrame;
  }
  if (error_) std::rethrow_exception(error_);
  return is_running_ ? ReadStatus::kTimeout : ReadStatus::kEnd;
}

std::unique_ptr<RgbdSource> in_real_time(std::unique_ptr<RgbdSource> recording, double speed) {
  if (!(speed > 0.0 && std::isfinite(speed))) {
    throw InputError("speed: expected a finite number > 0, got " + number_text(speed));
  }
  return std::make_unique<GrabThread>(std::make_unique<Paced>(std::move(recording), speed));
}

}  // namespace manip3d
