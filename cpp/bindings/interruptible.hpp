#pragma once

#include <pybind11/pybind11.h>

#include <chrono>
#include <memory>
#include <utility>

#include "manip3d/progress.hpp"

namespace manip3d::bindings {

/// A Progress for kernels that run without the GIL. Ten times a second it takes the GIL, lets
/// Python handle signals (Ctrl-C raises KeyboardInterrupt), and calls `callback(fraction)` if there
/// is a callback. It may be created and destroyed with or without the GIL.
inline Progress interruptible(std::shared_ptr<const pybind11::object> callback = nullptr) {
  using Clock = std::chrono::steady_clock;
  return [callback = std::move(callback), last = Clock::now()](double fraction) mutable {
    const auto now = Clock::now();
    if (now - last < std::chrono::milliseconds(100) && fraction < 1.0) return;
    last = now;
    const pybind11::gil_scoped_acquire gil;
    if (PyErr_CheckSignals() != 0) throw pybind11::error_already_set();
    if (callback) (*callback)(fraction);
  };
}

/// Overload for a Python callable or None.
inline Progress interruptible(const pybind11::object& callback) {
  if (callback.is_none()) return interruptible();
  const pybind11::gil_scoped_acquire gil;  // the reference count changes; copies share one owner
  return interruptible(std::shared_ptr<const pybind11::object>(
      new pybind11::object(callback), [](const pybind11::object* object) {
        const pybind11::gil_scoped_acquire gil_at_end;
        delete object;
      }));
}

}  // namespace manip3d::bindings
