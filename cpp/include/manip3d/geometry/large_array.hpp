#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

namespace manip3d {

/// Allocate at least `bytes` bytes, from huge pages if that is much: the first access to 160 MB
/// then takes 10 ms instead of 100.
/// @throws std::bad_alloc
void* allocate_large(std::size_t bytes);
void free_large(void* memory) noexcept;

/// A fixed number of trivial values, uninitialised, for results of millions of rows.
template <typename T>
class LargeArray {
 public:
  LargeArray() = default;
  explicit LargeArray(std::int64_t size)
      : data_(static_cast<T*>(allocate_large(static_cast<std::size_t>(size) * sizeof(T)))),
        size_(size) {}

  [[nodiscard]] T* data() { return data_.get(); }
  [[nodiscard]] const T* data() const { return data_.get(); }
  [[nodiscard]] std::int64_t size() const { return size_; }
  [[nodiscard]] T& operator[](std::int64_t i) { return data_.get()[i]; }
  [[nodiscard]] const T& operator[](std::int64_t i) const { return data_.get()[i]; }
  [[nodiscard]] std::span<T> span() { return {data(), static_cast<std::size_t>(size_)}; }
  [[nodiscard]] std::span<const T> span() const {
    return {data(), static_cast<std::size_t>(size_)};
  }

 private:
  struct Free {
    void operator()(T* memory) const noexcept { free_large(memory); }
  };
  std::unique_ptr<T, Free> data_;
  std::int64_t size_ = 0;
};

}  // namespace manip3d
