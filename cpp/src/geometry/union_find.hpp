#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <vector>

namespace manip3d {

/// Disjoint sets of the numbers from 0 [Tarjan, J. ACM 1975], with path halving. The root of a set
/// is its lowest number.
class UnionFind {
 public:
  explicit UnionFind(std::int64_t size = 0) { reset(size); }

  /// Makes `size` sets of one number each; keeps the memory.
  void reset(std::int64_t size) {
    parent_.resize(size);
    std::iota(parent_.begin(), parent_.end(), 0);
  }
  std::int32_t root(std::int32_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::int32_t i, std::int32_t j) {
    const auto [low, high] = std::minmax({root(i), root(j)});
    parent_[high] = low;
  }

 private:
  std::vector<std::int32_t> parent_;
};

}  // namespace manip3d
