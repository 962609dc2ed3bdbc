#pragma once

#include <atomic>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

namespace manip3d {

/// Union-find that several threads may modify concurrently [Anderson & Woll, STOC 1991]: a root
/// becomes the child of a lower one by compare-and-swap. The sets do not depend on the order of the
/// joins.
class SharedUnionFind {
 public:
  explicit SharedUnionFind(std::int64_t size) : parent_(size) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }

  void join(std::int32_t i, std::int32_t j) {
    if (at(i).load(std::memory_order_relaxed) == at(j).load(std::memory_order_relaxed)) return;
    for (;;) {
      i = root(i);
      j = root(j);
      if (i == j) return;
      if (i < j) std::swap(i, j);
      std::int32_t expected = i;
      if (at(i).compare_exchange_weak(expected, j, std::memory_order_relaxed)) return;
    }
  }

  /// Must not be called while threads join.
  [[nodiscard]] std::int64_t num_sets() const {
    std::int64_t sets = 0;
    for (std::size_t i = 0; i < parent_.size(); ++i) {
      sets += parent_[i] == static_cast<std::int32_t>(i) ? 1 : 0;
    }
    return sets;
  }

 private:
  std::atomic_ref<std::int32_t> at(std::int32_t i) { return std::atomic_ref(parent_[i]); }

  std::int32_t root(std::int32_t i) {
    for (;;) {
      std::int32_t parent = at(i).load(std::memory_order_relaxed);
      if (parent == i) return i;
      const std::int32_t above = at(parent).load(std::memory_order_relaxed);
      if (above == parent) return parent;
      // Halves the path; another thread may have done it already.
      at(i).compare_exchange_weak(parent, above, std::memory_order_relaxed);
      i = above;
    }
  }

  std::vector<std::int32_t> parent_;
};

}  // namespace manip3d
