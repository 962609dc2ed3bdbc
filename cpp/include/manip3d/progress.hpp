#pragma once

#include <cstdint>
#include <functional>

namespace manip3d {

/// Called by long kernels, from the calling thread only, at least ten times a second, with the
/// fraction done in [0, 1]. It may throw to cancel the work (the bindings do so on Ctrl-C); the
/// exception travels through the kernel to its caller. An empty function is fine.
using Progress = std::function<void(double fraction)>;

/// The progress of a part of the work that takes the whole from fraction `from` to `to`.
inline Progress part_of(const Progress& progress, double from, double to) {
  if (!progress) return {};
  return [=](double fraction) { progress(from + fraction * (to - from)); };
}

/// Lets a long loop be cancelled. It does not know how long the loop is: every so many steps it
/// reports the fraction 0, which part_of() maps to the begin of the loop's part of the work.
class Ticker {
 public:
  /// @param every  Steps between two reports, a power of two; they should take a few milliseconds.
  explicit Ticker(const Progress& progress, std::uint32_t every = 1U << 12)
      : progress_(progress), mask_(every - 1) {}

  /// To be called once in each step of the loop.
  /// @throws  what the progress function throws to cancel the work.
  void tick() {
    if ((++steps_ & mask_) == 0 && progress_) progress_(0.0);
  }

 private:
  Progress progress_;
  std::uint32_t mask_, steps_ = 0;
};

}  // namespace manip3d
