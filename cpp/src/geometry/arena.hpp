#pragma once

#include <cstddef>
#include <mutex>
#include <vector>

#include "manip3d/geometry/large_array.hpp"

namespace manip3d {

/// Memory for the tables of one call, from one piece, so that the system hands it out in huge
/// pages: page by page that takes a tenth of the time of a call of 40 ms. Any thread may take and
/// free.
class Arena {
 public:
  /// @param bytes  how much to hold; 0: nothing. What does not fit comes from the heap.
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
  std::vector<Range> gaps_;  // in order, none beside another
};

}  // namespace manip3d
