#pragma once

#include <cstddef>
#include <mutex>
#include <vector>

#include "manip3d/geometry/large_array.hpp"

namespace manip3d {

/// Memory for the tables of one call in a single block, so that the system provides huge pages:
/// with small pages, page faults take a tenth of a call of 40 ms. Any thread may take and free
/// memory.
class Arena {
 public:
  /// @param bytes  Size of the block; 0: none. Requests that do not fit are served from the heap.
  explicit Arena(std::size_t bytes);
  Arena(const Arena&) = delete;
  Arena& operator=(const Arena&) = delete;

  /// @throws std::bad_alloc
  void* take(std::size_t bytes);
  void free(void* memory, std::size_t bytes) noexcept;

 private:
  struct Range {
    std::size_t begin, end;
  };

  LargeArray<std::byte> memory_;
  std::mutex mutex_;
  std::vector<Range> gaps_;  // in order; adjacent gaps are merged
};

}  // namespace manip3d
