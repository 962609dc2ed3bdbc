#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace manip3d {

/// Items grouped by a key in [0, num_keys): a counting sort, in O(items + keys).
template <typename Item>
class Buckets {
 public:
  /// @param for_each  Called twice with a function put(key, item); it must pass the same pairs.
  template <typename ForEach>
  Buckets(std::int64_t num_keys, const ForEach& for_each)
      : offsets_(static_cast<std::size_t>(num_keys) + 1) {
    for_each([&](std::int32_t key, const Item&) { ++offsets_[key + 1]; });
    for (std::size_t k = 1; k < offsets_.size(); ++k) offsets_[k] += offsets_[k - 1];
    items_.resize(offsets_.back());
    std::vector<std::int32_t> next(offsets_.begin(), offsets_.end() - 1);
    for_each([&](std::int32_t key, const Item& item) { items_[next[key]++] = item; });
  }

  [[nodiscard]] std::int32_t num_keys() const {
    return static_cast<std::int32_t>(offsets_.size()) - 1;
  }
  [[nodiscard]] std::span<Item> operator[](std::int32_t key) {
    const std::size_t k = key;
    return std::span(items_).subspan(offsets_[k], offsets_[k + 1] - offsets_[k]);
  }

 private:
  std::vector<std::int32_t> offsets_;
  std::vector<Item> items_;
};

}  // namespace manip3d
