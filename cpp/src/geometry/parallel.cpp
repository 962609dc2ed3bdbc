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
#include <pthread.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>
#endif

namespace manip3d {
namespace {

using ChunkBody = std::function<void(std::int64_t chunk_index)>;

#ifdef MANIP3D_STD_THREADS
int available_threads() { return static_cast<int>(std::thread::hardware_concurrency()); }

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
/// The number of processors that this process may use. (hardware_concurrency() counts those of the
/// machine, and oneTBB prints a warning if more threads are requested than may run.)
int available_threads() { return tbb::info::default_concurrency(); }

/// Idle arenas, by number of threads. oneTBB 2021.8 leaks 14 to 29 KB with each arena that is
/// destroyed, so they are kept. Each call uses an arena of its own: concurrent calls do not share
/// threads, and there are as many arenas as there were concurrent calls.
class Arenas {
 public:
  using Arena = std::unique_ptr<tbb::task_arena>;

  Arena take(int num_threads) {
    const std::lock_guard lock(mutex_);
    std::vector<Arena>& idle = idle_of(num_threads);
    if (idle.empty()) return std::make_unique<tbb::task_arena>(num_threads);
    Arena arena = std::move(idle.back());
    idle.pop_back();
    return arena;
  }

  void give_back(int num_threads, Arena arena) {
    const std::lock_guard lock(mutex_);
    idle_of(num_threads).push_back(std::move(arena));
  }

 private:
  std::vector<Arena>& idle_of(int num_threads) {
    const std::size_t index = num_threads;
    if (idle_.size() <= index) idle_.resize(index + 1);
    return idle_[index];
  }

  std::mutex mutex_;
  std::vector<std::vector<Arena> > idle_;
};

/// Null before the first call, and in a child process, which does not have the parent's threads;
/// one of them may have held the lock. The arenas are never destroyed, because threads may still
/// use them at exit.
std::atomic<Arenas*> shared_arenas{nullptr};

Arenas& arenas() {
  [[maybe_unused]] static const int registered =
      ::pthread_atfork(nullptr, nullptr, [] { shared_arenas.store(nullptr); });
  Arenas* found = shared_arenas.load();
  if (found != nullptr) return *found;
  auto made = std::make_unique<Arenas>();
  if (shared_arenas.compare_exchange_strong(found, made.get())) return *made.release();
  return *found;
}

/// Borrows an arena for the duration of a call.
class BorrowedArena {
 public:
  explicit BorrowedArena(int num_threads)
      : arenas_(arenas()), num_threads_(num_threads), arena_(arenas_.take(num_threads)) {}
  BorrowedArena(const BorrowedArena&) = delete;
  BorrowedArena& operator=(const BorrowedArena&) = delete;
  ~BorrowedArena() { arenas_.give_back(num_threads_, std::move(arena_)); }

  template <typename Work>
  void execute(const Work& work) {
    arena_->execute(work);
  }

 private:
  Arenas& arenas_;
  int num_threads_;
  Arenas::Arena arena_;
};

void run_batch(std::int64_t first, std::int64_t last, int num_threads, const ChunkBody& body) {
  BorrowedArena arena(num_threads);
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
  const int available = std::max(1, available_threads());
  if (num_threads == 0 || num_threads > available) num_threads = available;

  const std::int64_t num_chunks = (count + chunk - 1) / chunk;
  const auto run_chunk = [&](std::int64_t i) { body(i * chunk, std::min(count, (i + 1) * chunk)); };
  // Batches bound the time between two calls of `progress`; without it, there is one batch.
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
