#include "manip3d/geometry/parallel.hpp"

#include <algorithm>
#include <string>
#include <thread>

#include "manip3d/error.hpp"

#ifdef MANIP3D_STD_THREADS
#include <atomic>
#include <exception>
#include <mutex>
#include <vector>
#else
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#endif

namespace manip3d {
namespace {

using ChunkBody = std::function<void(std::int64_t chunk_index)>;

#ifdef MANIP3D_STD_THREADS
void run_batch(std::int64_t first, std::int64_t last, int num_threads, const ChunkBody& body) {
  std::atomic<std::int64_t> next{first};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto work = [&] {
    for (std::int64_t i = next++; i < last; i = next++) {
      try {
        body(i);
      } catch (...) {
        const std::lock_guard lock(error_mutex);
        if (!error) error = std::current_exception();
        next = last;
      }
    }
  };
  std::vector<std::thread> threads;
  for (int t = 1; t < num_threads; ++t) threads.emplace_back(work);
  work();
  for (auto& thread : threads) thread.join();
  if (error) std::rethrow_exception(error);
}
#else
void run_batch(std::int64_t first, std::int64_t last, int num_threads, const ChunkBody& body) {
  tbb::task_arena arena(num_threads);
  arena.execute([&] { tbb::parallel_for(first, last, [&](std::int64_t i) { body(i); }); });
}
#endif

}  // namespace

void parallel_chunks(std::int64_t count, std::int64_t chunk, int num_threads,
                     const std::function<void(std::int64_t, std::int64_t)>& body,
                     const Progress& progress) {
  if (chunk < 1) throw InputError("chunk: expected >= 1, got " + std::to_string(chunk));
  if (num_threads < 0) {
    throw InputError("num_threads: expected >= 0, got " + std::to_string(num_threads));
  }
  const int available = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  if (num_threads == 0 || num_threads > available) num_threads = available;

  const std::int64_t num_chunks = (count + chunk - 1) / chunk;
  const auto run_chunk = [&](std::int64_t i) { body(i * chunk, std::min(count, (i + 1) * chunk)); };
  // Batches bound the time between two calls of progress; without it there is one batch.
  const std::int64_t batch = progress ? 8 * std::int64_t{num_threads} : num_chunks;
  for (std::int64_t first = 0; first < num_chunks; first += batch) {
    const std::int64_t last = std::min(num_chunks, first + batch);
    if (num_threads == 1) {
      for (std::int64_t i = first; i < last; ++i) run_chunk(i);
    } else {
      run_batch(first, last, num_threads, run_chunk);
    }
    if (progress) progress(static_cast<double>(last) / static_cast<double>(num_chunks));
  }
}

}  // namespace manip3d
