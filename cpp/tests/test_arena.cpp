#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <thread>
#include <vector>

#include "geometry/arena.hpp"
#include "geometry/bulk.hpp"

namespace manip3d {
namespace {

TEST(Arena, HandsOutWhatWasFreed) {
  Arena arena(1024);
  void* const first = arena.take(500);   // takes 512
  void* const second = arena.take(100);  // takes 128
  void* const third = arena.take(300);   // takes 320
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(second) - reinterpret_cast<std::uintptr_t>(first),
            512);
  arena.free(first, 500);
  arena.free(third, 300);
  arena.free(second, 100);  // joins both gaps
  EXPECT_EQ(arena.take(1024), first);
  arena.free(first, 1024);
}

TEST(Arena, GivesFromTheHeapWhatDoesNotFit) {
  for (const std::size_t size : {std::size_t{0}, std::size_t{256}}) {
    Arena arena(size);
    auto* const memory = static_cast<std::byte*>(arena.take(4096));
    memory[0] = memory[4095] = std::byte{1};
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(memory) % 64, 0);
    arena.free(memory, 4096);
  }
}

TEST(Arena, KeepsTablesApartThatThreadsFill) {
  Arena arena(1 << 16);
  std::vector<int> wrong(4, 0);
  std::vector<std::thread> threads;
  for (int own = 0; own < 4; ++own) {
    threads.emplace_back([&arena, &wrong, own] {
      for (int round = 0; round < 200; ++round) {
        Bulk<std::int32_t> table{arena};
        for (int i = 0; i < 1000; ++i) table.push_back(own);
        for (const std::int32_t value : table) wrong[own] += value == own ? 0 : 1;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, std::vector<int>(4, 0));
}

TEST(Arena, TablesKeepTheirRowsWhenTheyGrowMoveAndSwap) {
  Arena arena(4096);
  Bulk<std::int32_t> one{arena}, other{arena};
  for (std::int32_t i = 0; i < 3000; ++i) one.push_back(i);  // outgrows the arena
  other.assign(5, 7);
  one.swap(other);
  EXPECT_EQ(one, (Bulk<std::int32_t>(5, 7, arena)));
  const Bulk<std::int32_t> moved = std::move(other);
  ASSERT_EQ(moved.size(), 3000U);
  for (std::int32_t i = 0; i < 3000; ++i) EXPECT_EQ(moved[i], i);
}

}  // namespace
}  // namespace manip3d
