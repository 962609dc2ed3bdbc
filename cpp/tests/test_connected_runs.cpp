#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "allocations.hpp"
#include "geometry/median.hpp"
#include "geometry/shared_union_find.hpp"
#include "geometry/union_find.hpp"
#include "manip3d/geometry/connected_runs.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

struct Mask {
  std::int64_t rows, columns;
  std::vector<std::uint8_t> cells;
};

Mask random_mask(std::uint64_t seed, double share) {
  Mask mask{1 + static_cast<std::int64_t>(8.0 * uniform(seed, 0)),
            1 + static_cast<std::int64_t>(12.0 * uniform(seed, 1)),
            {}};
  for (std::int64_t i = 0; i < mask.rows * mask.columns; ++i) {
    mask.cells.push_back(uniform(seed, 2 + i) < share ? 1 : 0);
  }
  return mask;
}

// Brute force: the smallest number spreads from cell to cell until nothing changes. Components are
// then numbered by their first cells.
std::vector<int> spread(const Mask& mask, bool goes_round) {
  std::vector<int> label(mask.cells.size(), -1);
  for (std::size_t i = 0; i < label.size(); ++i) label[i] = mask.cells[i] != 0 ? int(i) : -1;
  for (bool changed = true; changed;) {
    changed = false;
    for (std::int64_t r = 0; r < mask.rows; ++r) {
      for (std::int64_t c = 0; c < mask.columns; ++c) {
        int& mine = label[r * mask.columns + c];
        for (std::int64_t k = 0; k < 9 && mine >= 0; ++k) {
          const std::int64_t y = r + k / 3 - 1;
          std::int64_t x = c + k % 3 - 1;
          if (goes_round) x = (x + mask.columns) % mask.columns;
          if (y < 0 || y >= mask.rows || x < 0 || x >= mask.columns) continue;
          const int other = label[y * mask.columns + x];
          if (other < 0 || other >= mine) continue;
          mine = other;
          changed = true;
        }
      }
    }
  }
  std::vector<int> number(label.size(), -1);
  int count = 0;
  for (std::size_t i = 0; i < label.size(); ++i) {
    if (label[i] == int(i)) number[i] = count++;
    if (label[i] >= 0) label[i] = number[label[i]];
  }
  return label;
}

TEST(ConnectedRuns, AreThoseOfSpreadingLabels) {
  ConnectedRuns connected;
  for (std::uint64_t seed = 0; seed < 2000; ++seed) {
    const Mask mask = random_mask(seed, 0.1 + 0.2 * static_cast<double>(seed % 4));
    for (const bool goes_round : {false, true}) {
      std::vector<int> found(mask.cells.size(), -1);
      std::int32_t count = 0;
      for (const MarkedRun& run :
           connected.find(mask.cells.data(), mask.rows, mask.columns, goes_round)) {
        for (std::int64_t c = run.first; c <= run.last; ++c) {
          found[run.row * mask.columns + c] = run.component;
        }
        count = std::max(count, run.component + 1);
      }
      EXPECT_EQ(connected.num_components(), count);
      ASSERT_EQ(found, spread(mask, goes_round)) << seed << ' ' << goes_round;
    }
  }
}

TEST(ConnectedRuns, KeepTheirMemory) {
  if (!testing::kCountsAllocations) GTEST_SKIP() << "the sanitizer has operators of its own";
  const std::vector<std::uint8_t> cells(64 * 64, 1);
  ConnectedRuns connected;
  connected.find(cells.data(), 64, 64, true);
  const std::int64_t before = testing::num_allocations();
  EXPECT_EQ(connected.find(cells.data(), 64, 64, true).size(), 64U);
  EXPECT_EQ(testing::num_allocations(), before);
}

TEST(UnionFind, TheLeastIsTheRoot) {
  UnionFind sets(6);
  sets.join(5, 3);
  sets.join(4, 5);
  sets.join(2, 2);
  sets.join(0, 1);
  std::vector<std::int32_t> roots;
  for (std::int32_t i = 0; i < 6; ++i) roots.push_back(sets.root(i));
  EXPECT_EQ(roots, (std::vector<std::int32_t>{0, 0, 2, 3, 3, 3}));
}

TEST(SharedUnionFind, ThreadsThatJoinAtTheSameTimeLoseNothing) {
  // Chains of every seventh number; each number is joined with the previous and the next one.
  constexpr std::int64_t kSize = 100'000;
  SharedUnionFind sets(kSize);
  EXPECT_EQ(sets.num_sets(), kSize);
  parallel_chunks(kSize - 7, 64, 4, [&](std::int64_t begin, std::int64_t end) {
    for (auto i = static_cast<std::int32_t>(begin); i < end; ++i) sets.join(i + 7, i);
  });
  EXPECT_EQ(sets.num_sets(), 7);
  sets.join(99'999, 99'998);
  EXPECT_EQ(sets.num_sets(), 6);
}

TEST(Median, OfAnEvenNumberIsTheUpperOrTheLower) {
  std::vector<int> one = {7}, even = {4, 1, 3, 2}, odd = {5, 1, 4};
  EXPECT_EQ(median(std::span(one)), 7);
  EXPECT_EQ(median(std::span(one), Middle::kLower), 7);
  EXPECT_EQ(median(std::span(even)), 3);
  EXPECT_EQ(median(std::span(even), Middle::kLower), 2);
  EXPECT_EQ(median(std::span(odd)), 4);
  EXPECT_EQ(median(std::span(odd), Middle::kLower), 4);
}

}  // namespace
}  // namespace manip3d
