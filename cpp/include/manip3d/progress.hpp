#pragma once

#include <functional>

namespace manip3d {

/// Called by long kernels, from the calling thread only, at least ten times a second, with the
/// fraction done in [0, 1]. It may throw to cancel the work (the bindings do so on Ctrl-C); the
/// exception travels through the kernel to its caller. An empty function is fine.
using Progress = std::function<void(double fraction)>;

}  // namespace manip3d
