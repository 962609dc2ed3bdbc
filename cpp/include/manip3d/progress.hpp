#pragma once

#include <cstdint>
#include <functional>

namespace manip3d {

/// Called by long kernels at least ten times a second, from the calling thread only, with the
/// finished fraction in [0, 1]. It may throw to cancel the work (the bindings do so on Ctrl-C); the
/// exception passes through the kernel to its caller. It may be empty.
using Progress = std::function<void(double fraction)>;

/// The progress of a part of the work, mapped to fractions `from` to `to` of the whole.
inline Progress part_of(const Progress& progress, double from, double to) {
  if (!progress) return {};
  return [=](double fraction) { progress(from + fraction * (to - from)); };
}

/// Makes a long loop cancellable. Its number of steps is unknown: every `every` steps it reports
/// the fraction 0, which part_of() maps to the beginning of the loop's part of the work.
class Ticker {
 public:
  /// @param every  Steps between two reports, a power of two; they should take a few milliseconds.
  explicit Ticker(const Progress& progress, std::uint32_t every = 1U << 12)
      : progress_(progress), mask_(every - 1) {}

  /// To be called once in each step of the loop.
  /// @throws  the exception by which the progress function cancels the work.
  void tick() {
    if ((++steps_ & mask_) == 0 && progress_) progress_(0.0);
  }

 private:
  Progress progress_;
  std::uint32_t mask_, steps_ = 0;
};

}  // namespace manip3d
