#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <vector>

#include "io/mesh_builder.hpp"
#include "parse/input_buffer.hpp"

namespace manip3d {

/// Gives equal rows of numbers one index, in order of appearance, for formats that repeat the
/// attributes of each corner. A hash table with open addressing on the table itself, at least 8
/// bytes per row.
template <typename Matrix>
class UniqueRows {
 public:
  static constexpr std::size_t kColumns = Matrix::ColsAtCompileTime;
  using Row = std::array<double, kColumns>;

  explicit UniqueRows(GrowingTable<Matrix>& table) : table_(table), slots_(1024, kEmpty) {}

  std::int32_t index(Row row, const InputBuffer& input) {
    for (double& x : row) x += 0.0;  // -0 becomes +0, which compares equal
    if (2 * static_cast<std::size_t>(table_.size()) >= slots_.size()) grow();
    const std::size_t slot = find(row);
    if (slots_[slot] == kEmpty) {
      slots_[slot] = static_cast<std::int32_t>(table_.size());
      std::copy(row.begin(), row.end(), table_.append(input));
    }
    return slots_[slot];
  }

 private:
  static constexpr std::int32_t kEmpty = -1;

  static std::size_t hash(const double* row) {
    constexpr std::uint64_t kMix = 0x9E3779B97F4A7C15U;  // 2^64 / golden ratio
    std::uint64_t hash = 0;
    for (std::size_t k = 0; k < kColumns; ++k) {
      const auto bits = std::bit_cast<std::uint64_t>(row[k]);
      hash = (hash ^ bits ^ (bits >> 29U)) * kMix;
      hash ^= hash >> 32U;
    }
    return hash;
  }

  // The slot of an equal row, or the empty slot for a new one.
  std::size_t find(const Row& row) const {
    const std::size_t mask = slots_.size() - 1;
    std::size_t slot = hash(row.data()) & mask;
    while (slots_[slot] != kEmpty &&
           !std::equal(row.begin(), row.end(), table_.row(slots_[slot]))) {
      slot = (slot + 1) & mask;
    }
    return slot;
  }

  void grow() {
    // The table may also have grown by rows that were appended directly.
    slots_.assign(std::bit_ceil(4 * static_cast<std::size_t>(table_.size())), kEmpty);
    for (std::int64_t i = 0; i < table_.size(); ++i) {
      Row row;
      std::copy_n(table_.row(i), kColumns, row.begin());
      slots_[find(row)] = static_cast<std::int32_t>(i);
    }
  }

  GrowingTable<Matrix>& table_;
  std::vector<std::int32_t> slots_;
};

}  // namespace manip3d
