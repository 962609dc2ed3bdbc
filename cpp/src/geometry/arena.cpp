#include "geometry/arena.hpp"

#include <algorithm>
#include <functional>
#include <iterator>
#include <new>

namespace manip3d {
namespace {

constexpr std::size_t kAlignment = 64;  // bytes of a cache line
constexpr std::size_t kMaxGaps = 1024;

std::size_t rounded_up(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace

Arena::Arena(std::size_t bytes) {
  if (bytes == 0) return;
  memory_ = LargeArray<std::byte>(static_cast<std::int64_t>(bytes));
  gaps_.reserve(kMaxGaps);
  gaps_.push_back({0, bytes / kAlignment * kAlignment});
}

void* Arena::take(std::size_t bytes) {
  const std::size_t size = rounded_up(bytes);
  if (memory_.size() > 0) {
    const std::scoped_lock lock(mutex_);
    const auto gap = std::find_if(gaps_.begin(), gaps_.end(), [&](const Range& range) {
      return range.end - range.begin >= size;
    });
    if (gap != gaps_.end()) {
      std::byte* const memory = memory_.data() + gap->begin;
      gap->begin += size;
      if (gap->begin == gap->end) gaps_.erase(gap);
      return memory;
    }
  }
  return ::operator new(size, std::align_val_t{kAlignment});
}

void Arena::free(void* memory, std::size_t bytes) noexcept {
  auto* const place = static_cast<std::byte*>(memory);
  const std::less<> before;
  if (memory_.size() == 0 || before(place, memory_.data()) ||
      !before(place, memory_.data() + memory_.size())) {
    ::operator delete(memory, std::align_val_t{kAlignment});
    return;
  }
  const auto begin = static_cast<std::size_t>(place - memory_.data());
  const Range range{begin, begin + rounded_up(bytes)};
  const std::scoped_lock lock(mutex_);
  auto after = std::find_if(gaps_.begin(), gaps_.end(),
                            [&](const Range& gap) { return gap.begin >= range.end; });
  const bool joins_after = after != gaps_.end() && after->begin == range.end;
  const bool joins_before = after != gaps_.begin() && std::prev(after)->end == range.begin;
  if (joins_before && joins_after) {
    std::prev(after)->end = after->end;
    gaps_.erase(after);
  } else if (joins_before) {
    std::prev(after)->end = range.end;
  } else if (joins_after) {
    after->begin = range.begin;
    // Otherwise the memory is not reused in this call, because freeing must not fail.
  } else if (gaps_.size() < kMaxGaps) {
    gaps_.insert(after, range);
  }
}

}  // namespace manip3d
