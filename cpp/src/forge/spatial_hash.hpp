#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/random.hpp"

namespace manip3d {

/// Points in cubic cells, found by the cell's number: what is near a point within one cell size.
class SpatialHash {
 public:
  using Cell = Eigen::Matrix<std::int64_t, 3, 1>;

  explicit SpatialHash(double cell_size) : cell_size_(cell_size), slots_(1024) {}

  [[nodiscard]] Cell cell_of(const Eigen::Vector3d& p) const {
    return (p / cell_size_).array().floor().cast<std::int64_t>();
  }

  /// Items are 0, 1, 2, ... in the order of insertion.
  void insert(const Cell& cell) {
    if (2 * next_.size() >= slots_.size()) grow();
    Slot& slot = slots_[find(cell)];
    slot.cell = cell;
    next_.push_back(slot.last);
    slot.last = static_cast<std::int32_t>(next_.size()) - 1;
  }

  /// Is `predicate(item)` true of an item of the cell?
  template <typename Predicate>
  [[nodiscard]] bool any(const Cell& cell, const Predicate& predicate) const {
    for (std::int32_t item = slots_[find(cell)].last; item >= 0; item = next_[item]) {
      if (predicate(item)) return true;
    }
    return false;
  }

 private:
  struct Slot {
    Cell cell;
    std::int32_t last = -1;  // -1: nothing here
  };

  void grow() {
    std::vector<Slot> old(2 * slots_.size());
    old.swap(slots_);
    for (const Slot& slot : old) {
      if (slot.last >= 0) slots_[find(slot.cell)] = slot;
    }
  }

  [[nodiscard]] std::size_t find(const Cell& cell) const {
    const auto bits = [](std::int64_t i) { return static_cast<std::uint64_t>(i); };
    const std::uint64_t hash =
        mix(bits(cell.x()) * 0x9E3779B97F4A7C15U + bits(cell.y()) * 0xC2B2AE3D27D4EB4FU +
            bits(cell.z()) * 0x165667B19E3779F9U);
    const std::size_t mask = slots_.size() - 1;
    std::size_t i = hash & mask;
    while (slots_[i].last >= 0 && slots_[i].cell != cell) i = (i + 1) & mask;
    return i;
  }

  double cell_size_;
  std::vector<Slot> slots_;
  std::vector<std::int32_t> next_;
};

}  // namespace manip3d
