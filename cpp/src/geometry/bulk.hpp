#pragma once

#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace manip3d {

/// Leaves what a vector makes without a value as the memory is.
template <typename T>
struct WithoutValue : std::allocator<T> {
  template <typename U>
  struct rebind {
    using other = WithoutValue<U>;
  };
  template <typename U, typename... Args>
  void construct(U* place, Args&&... args) {
    if constexpr (sizeof...(Args) == 0) {
      ::new (static_cast<void*>(place)) U;
    } else {
      ::new (static_cast<void*>(place)) U(std::forward<Args>(args)...);
    }
  }
};

/// A large table whose rows are all written before they are read: resize() touches no memory, so
/// that threads do, each its own part.
template <typename T>
using Bulk = std::vector<T, WithoutValue<T>>;

}  // namespace manip3d
