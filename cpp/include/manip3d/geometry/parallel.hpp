#pragma once

#include <cstdint>
#include <functional>

#include "manip3d/progress.hpp"

namespace manip3d {

/// Runs `body(begin, end)` over [0, count) in fixed chunks of `chunk` items.
///
/// The chunks do not depend on the number of threads, so a body that writes only to its own range
/// (or to a slot of its own chunk, `begin / chunk`) gives the same bytes for any `num_threads`. The
/// first exception of a body is rethrown in the caller.
/// @param num_threads  0: all cores of this process, which is also the maximum; 1: only the calling
///                     thread.
/// @param progress     Called between batches of chunks, in the calling thread.
/// @throws InputError  chunk < 1 or num_threads < 0.
void parallel_chunks(std::int64_t count, std::int64_t chunk, int num_threads,
                     const std::function<void(std::int64_t begin, std::int64_t end)>& body,
                     const Progress& progress = {});

}  // namespace manip3d
