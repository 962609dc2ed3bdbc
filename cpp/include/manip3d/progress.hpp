#pragma once

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

}  // namespace manip3d
