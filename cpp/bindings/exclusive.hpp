#pragma once

#include <pybind11/pybind11.h>

#include <algorithm>
#include <chrono>
#include <concepts>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "manip3d/error.hpp"

namespace manip3d::bindings {

/// A lock for Python threads, acquired and released with the GIL held. Waiting threads release the
/// GIL, are served in the order of arrival, and stop waiting on Ctrl-C.
class Turnstile {
 public:
  /// @throws Error  the calling thread holds the lock already, for example in a progress callback.
  void enter() {
    const auto self = std::this_thread::get_id();
    std::unique_lock lock(mutex_);
    if (owner_ == self) throw Error("an object cannot be used from within its own method");
    if (!owner_ && queue_.empty()) {
      owner_ = self;
      return;
    }
    const std::uint64_t ticket = next_ticket_++;
    queue_.push_back(ticket);
    lock.unlock();
    wait_for_turn(ticket, self);
  }

  void leave() {
    const std::lock_guard lock(mutex_);
    owner_.reset();
    changed_.notify_all();
  }

 private:
  void wait_for_turn(std::uint64_t ticket, std::thread::id self) {
    while (!take_turn(ticket, self)) {
      if (PyErr_CheckSignals() == 0) continue;
      give_up(ticket);
      throw pybind11::error_already_set();
    }
  }

  // Returns false if it is not this thread's turn within 0.1 s.
  bool take_turn(std::uint64_t ticket, std::thread::id self) {
    const pybind11::gil_scoped_release nogil;
    std::unique_lock lock(mutex_);
    const bool is_next = changed_.wait_for(lock, std::chrono::milliseconds(100),
                                           [&] { return !owner_ && queue_.front() == ticket; });
    if (!is_next) return false;
    queue_.pop_front();
    owner_ = self;
    return true;
  }

  void give_up(std::uint64_t ticket) {
    const std::lock_guard lock(mutex_);
    queue_.erase(std::find(queue_.begin(), queue_.end(), ticket));
    changed_.notify_all();
  }

  std::mutex mutex_;  // guards the members below; locked only while they are read or changed
  std::condition_variable changed_;
  std::optional<std::thread::id> owner_;
  std::deque<std::uint64_t> queue_;
  std::uint64_t next_ticket_ = 0;
};

/// An object with state that Python may use from any thread; only one thread uses it at a time.
template <typename T>
class Exclusive {
 public:
  template <typename... Arguments>
    requires std::constructible_from<T, Arguments...>
  explicit Exclusive(Arguments&&... arguments) : value_(std::forward<Arguments>(arguments)...) {}

  /// Returns `use(value)`, with the GIL held. No other thread uses the value meanwhile.
  template <typename Use>
  decltype(auto) with(Use&& use) {
    turnstile_.enter();
    const Leave leave{turnstile_};
    return std::forward<Use>(use)(value_);
  }

  /// The object itself, for members that may run beside any other (`stop` of a live source).
  T& shared() { return value_; }

 private:
  struct Leave {
    Turnstile& turnstile;
    ~Leave() { turnstile.leave(); }
  };

  T value_;
  Turnstile turnstile_;
};

/// Binds a member function as a method of Exclusive<T>.
template <typename T, typename Result, typename... Arguments>
auto exclusively(Result (T::*method)(Arguments...)) {
  return [method](Exclusive<T>& self, Arguments... arguments) -> Result {
    return self.with(
        [&](T& value) -> Result { return (value.*method)(std::forward<Arguments>(arguments)...); });
  };
}

template <typename T, typename Result, typename... Arguments>
auto exclusively(Result (T::*method)(Arguments...) const) {
  return [method](Exclusive<T>& self, Arguments... arguments) -> Result {
    return self.with([&](const T& value) -> Result {
      return (value.*method)(std::forward<Arguments>(arguments)...);
    });
  };
}

}  // namespace manip3d::bindings
