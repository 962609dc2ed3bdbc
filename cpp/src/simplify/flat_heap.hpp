#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace manip3d {

/// Priority queue with the smallest element on top: a 4-ary heap in which the children of a node
/// are adjacent in memory. It has half the levels of std::priority_queue, whose speed is limited by
/// cache misses.
template <typename T>
class FlatHeap {
 public:
  [[nodiscard]] bool empty() const { return heap_.empty(); }
  [[nodiscard]] const T& top() const { return heap_.front(); }

  void push(const T& element) {
    std::size_t i = heap_.size();
    heap_.push_back(element);
    for (; i > 0 && element < heap_[(i - 1) / 4]; i = (i - 1) / 4) heap_[i] = heap_[(i - 1) / 4];
    heap_[i] = element;
  }

  void pop() {
    const T last = heap_.back();
    heap_.pop_back();
    if (heap_.empty()) return;
    std::size_t i = 0;
    for (std::size_t first = 1; first < heap_.size(); first = 4 * i + 1) {
      const auto children = heap_.begin() + static_cast<std::ptrdiff_t>(first);
      const auto count =
          static_cast<std::ptrdiff_t>(std::min<std::size_t>(4, heap_.size() - first));
      const auto least = std::min_element(children, children + count);
      if (!(*least < last)) break;
      heap_[i] = *least;
      i = static_cast<std::size_t>(least - heap_.begin());
    }
    heap_[i] = last;
  }

 private:
  std::vector<T> heap_;
};

}  // namespace manip3d
