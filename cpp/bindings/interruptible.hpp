#pragma once

#include <pybind11/pybind11.h>

#include <chrono>

#include "manip3d/progress.hpp"

namespace manip3d::bindings {

/// A Progress for kernels that run without the GIL: ten times a second it takes the GIL, lets
/// Python handle signals (Ctrl-C raises KeyboardInterrupt) and calls `callback(fraction)` unless
/// that is None.
inline Progress interruptible(const pybind11::object& callback = pybind11::none()) {
  using Clock = std::chrono::steady_clock;
  // The reference count of `callback` must not change without the GIL: share one owner.
  auto owned = std::shared_ptr<pybind11::object>(new pybind11::object(callback),
                                                 [](pybind11::object* object) {
                                                   const pybind11::gil_scoped_acquire gil;
                                                   delete object;
                                                 });
  return [owned, last = Clock::now()](double fraction) mutable {
    const auto now = Clock::now();
    if (now - last < std::chrono::milliseconds(100) && fraction < 1.0) return;
    last = now;
    const pybind11::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() != 0) throw pybind11::error_already_set();
    if (!owned->is_none()) (*owned)(fraction);
  };
}

}  // namespace manip3d::bindings
