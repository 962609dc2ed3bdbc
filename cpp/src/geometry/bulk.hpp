#pragma once

#include <cstddef>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

#include "geometry/arena.hpp"

namespace manip3d {

/// An allocator that leaves values uninitialized, and takes memory from an arena if it has one.
template <typename T>
class WithoutValue {
 public:
  using value_type = T;
  using propagate_on_container_move_assignment = std::true_type;
  using propagate_on_container_swap = std::true_type;

  WithoutValue() = default;
  WithoutValue(Arena& arena) : arena_(&arena) {}  // NOLINT: Bulk<T> table{arena}
  template <typename U>
  WithoutValue(const WithoutValue<U>& other) : arena_(other.arena()) {}  // NOLINT: rebinds

  [[nodiscard]] Arena* arena() const { return arena_; }

  T* allocate(std::size_t count) {
    if (count > static_cast<std::size_t>(-1) / 2 / sizeof(T)) throw std::bad_array_new_length();
    const std::size_t bytes = count * sizeof(T);
    if (arena_ != nullptr) return static_cast<T*>(arena_->take(bytes));
    return static_cast<T*>(::operator new(bytes, std::align_val_t{alignof(T)}));
  }
  void deallocate(T* memory, std::size_t count) noexcept {
    if (arena_ != nullptr) {
      arena_->free(memory, count * sizeof(T));
    } else {
      ::operator delete(memory, std::align_val_t{alignof(T)});
    }
  }
  template <typename U, typename... Args>
  void construct(U* place, Args&&... args) {
    if constexpr (sizeof...(Args) == 0) {
      ::new (static_cast<void*>(place)) U;
    } else {
      ::new (static_cast<void*>(place)) U(std::forward<Args>(args)...);
    }
  }
  template <typename U>
  bool operator==(const WithoutValue<U>& other) const {
    return arena_ == other.arena();
  }

 private:
  Arena* arena_ = nullptr;
};

/// A large table whose rows are all written before they are read. resize() does not touch the
/// memory, so each thread can touch its own part first.
template <typename T>
using Bulk = std::vector<T, WithoutValue<T>>;

}  // namespace manip3d
