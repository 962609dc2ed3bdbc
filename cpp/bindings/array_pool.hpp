#pragma once

#include <pybind11/numpy.h>

#include <algorithm>
#include <cstddef>
#include <deque>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "manip3d/error.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {

/// A pool of arrays. The memory of an array returns to the pool when the last Python reference to
/// it, or to a view of it, is gone; the next array of this size reuses it with its pages. Arrays of
/// a frame are so large that the system would otherwise unmap their pages, and clear new ones for
/// each frame.
class ArrayPool {
 public:
  /// An array with undefined contents.
  pybind11::array empty(const std::vector<pybind11::ssize_t>& shape,
                        const Named<"numpy.typing.DTypeLike">& type) {
    const auto dtype = pybind11::dtype::from_args(type);
    constexpr pybind11::ssize_t kMost = pybind11::ssize_t{1} << 40;  // bytes
    pybind11::ssize_t size = dtype.itemsize();
    for (const pybind11::ssize_t length : shape) {
      if (length < 0 || (length > 0 && size > kMost / length)) {
        throw InputError("shape: expected lengths of at least 0, of 2^40 bytes at most in all");
      }
      size *= length;
    }
    auto block = std::make_unique<Block>(Block{shelf_, shelf_->take(size)});
    void* data = block->memory.bytes.get();
    const pybind11::capsule owner(block.get(), [](void* p) {
      const std::unique_ptr<Block> back(static_cast<Block*>(p));
      back->shelf->put(std::move(back->memory));
    });
    static_cast<void>(block.release());
    return pybind11::array(dtype, shape, data, owner);
  }

 private:
  struct Memory {
    std::size_t size = 0;
    std::unique_ptr<std::byte[]> bytes;
  };

  /// Unused memory. Of several blocks with the wanted size, the last returned one is taken. Lives
  /// as long as the pool or any of its arrays.
  class Shelf {
   public:
    Memory take(std::size_t size) {
      {
        const std::lock_guard lock(mutex_);
        const auto found = std::find_if(free_.rbegin(), free_.rend(),
                                        [&](const Memory& m) { return m.size == size; });
        if (found != free_.rend()) {
          Memory memory = std::move(*found);
          free_.erase(std::next(found).base());
          return memory;
        }
      }
      return {size, std::make_unique_for_overwrite<std::byte[]>(std::max<std::size_t>(size, 1))};
    }
    void put(Memory memory) {
      constexpr std::size_t kMost = 24;  // three frames of eight arrays
      const std::lock_guard lock(mutex_);
      free_.push_back(std::move(memory));
      if (free_.size() > kMost) free_.pop_front();
    }

   private:
    std::mutex mutex_;
    std::deque<Memory> free_;
  };

  struct Block {
    std::shared_ptr<Shelf> shelf;
    Memory memory;
  };

  std::shared_ptr<Shelf> shelf_ = std::make_shared<Shelf>();
};

}  // namespace manip3d::bindings
