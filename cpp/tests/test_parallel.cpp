#include <gtest/gtest.h>

#include <numeric>
#include <stdexcept>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

TEST(ParallelChunks, CoversEachItemOnceWithFixedChunks) {
  for (const int num_threads : {1, 2, 4}) {
    std::vector<int> visits(1000, 0);
    std::vector<std::int64_t> sizes(16, 0);
    parallel_chunks(1000, 64, num_threads, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) ++visits[i];
      sizes[begin / 64] = end - begin;
    });
    EXPECT_EQ(visits, std::vector<int>(1000, 1));
    EXPECT_EQ(std::accumulate(sizes.begin(), sizes.end(), std::int64_t{0}), 1000);
    EXPECT_EQ(sizes.back(), 1000 - 15 * 64);
  }
}

TEST(ParallelChunks, RethrowsTheBodysErrorAndTheProgresss) {
  const auto fail = [](std::int64_t begin, std::int64_t) {
    if (begin == 512) throw std::out_of_range("chunk 8");
  };
  EXPECT_THROW(parallel_chunks(1000, 64, 2, fail), std::out_of_range);
  const auto cancel = [](double) { throw std::domain_error("cancelled"); };
  EXPECT_THROW(parallel_chunks(10, 1, 2, [](auto, auto) {}, cancel), std::domain_error);
}

TEST(ParallelChunks, RefusesBadArguments) {
  const auto nothing = [](std::int64_t, std::int64_t) {};
  EXPECT_THROW(parallel_chunks(1, 0, 1, nothing), InputError);
  EXPECT_THROW(parallel_chunks(1, 1, -1, nothing), InputError);
  EXPECT_NO_THROW(parallel_chunks(0, 1, 1, nothing));
}

}  // namespace
}  // namespace manip3d
