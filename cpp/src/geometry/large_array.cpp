#include "manip3d/geometry/large_array.hpp"

#include <sys/mman.h>

#include <cstdlib>
#include <new>

namespace manip3d {
namespace {

constexpr std::size_t kHugePage = std::size_t{1} << 21;

}  // namespace

void* allocate_large(std::size_t bytes) {
  const bool large = bytes >= 2 * kHugePage;
  const std::size_t alignment = large ? kHugePage : 64;
  const std::size_t rounded = (bytes / alignment + 1) * alignment;
  void* memory = std::aligned_alloc(alignment, rounded);
  if (memory == nullptr) throw std::bad_alloc();
  if (large) madvise(memory, rounded, MADV_HUGEPAGE);  // failure only costs time
  return memory;
}

void free_large(void* memory) noexcept { std::free(memory); }

}  // namespace manip3d
