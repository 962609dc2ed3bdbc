#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <numeric>
#include <stdexcept>
#include <thread>
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

TEST(ParallelChunks, ManyCallsAtOnceAndWithinEachOther) {
  constexpr int kCallers = 8;
  std::vector<std::int64_t> sums(kCallers, 0);
  std::vector<std::thread> callers;
  for (int c = 0; c < kCallers; ++c) {
    callers.emplace_back([&sums, c] {
      std::vector<std::int64_t> parts(16, 0);
      for (int round = 0; round < 50; ++round) {
        parallel_chunks(16, 1, 1 + c % 4, [&](std::int64_t i, std::int64_t) {
          std::vector<std::int64_t> inner(8, 0);
          parallel_chunks(8, 1, 2, [&](std::int64_t k, std::int64_t) {
            inner[static_cast<std::size_t>(k)] = k;
          });
          parts[static_cast<std::size_t>(i)] =
              std::accumulate(inner.begin(), inner.end(), std::int64_t{0});
        });
      }
      sums[static_cast<std::size_t>(c)] =
          std::accumulate(parts.begin(), parts.end(), std::int64_t{0});
    });
  }
  for (auto& caller : callers) caller.join();
  EXPECT_EQ(sums, std::vector<std::int64_t>(kCallers, 16 * 28));
}

TEST(ParallelChunks, WorksInAChildThatWasForkedAmidAnotherCall) {
#ifdef __SANITIZE_THREAD__
  GTEST_SKIP() << "the thread sanitizer forbids threads in such a child";
#endif
  parallel_chunks(2, 1, 2, [](std::int64_t, std::int64_t) {});  // leaves an arena for the next call
  std::atomic<bool> is_inside = false, may_go_on = false;
  std::thread other([&] {
    parallel_chunks(2, 1, 2, [&](std::int64_t, std::int64_t) {
      is_inside = true;
      while (!may_go_on) std::this_thread::yield();
    });
  });
  while (!is_inside) std::this_thread::yield();
  const pid_t child = fork();
  if (child == 0) {
    alarm(60);  // kills a child that waits for the parent's threads
    std::atomic<int> items = 0;
    parallel_chunks(100, 1, 2, [&](std::int64_t, std::int64_t) { ++items; });
    _exit(items == 100 ? 0 : 1);
  }
  int status = -1;
  waitpid(child, &status, 0);
  may_go_on = true;
  other.join();
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
}

}  // namespace
}  // namespace manip3d
