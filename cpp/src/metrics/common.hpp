#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/metrics/metro.hpp"

/// @file
/// Code shared by the metrics: checks, centring, sums in a fixed order.
namespace manip3d {

constexpr std::int64_t kSampleChunk = 1024;

/// Sum, sum of squares and maximum. Those of chunks are combined in the order of the chunks, so
/// that the result does not depend on the number of threads.
struct Moments {
  double sum = 0.0;
  double squares = 0.0;
  double max = 0.0;
  std::int64_t count = 0;

  void add(double value) {
    sum += value;
    squares += value * value;
    max = std::max(max, value);
    ++count;
  }
  void add(const Moments& other) {
    sum += other.sum;
    squares += other.squares;
    max = std::max(max, other.max);
    count += other.count;
  }
  [[nodiscard]] double mean() const { return sum / static_cast<double>(count); }
  [[nodiscard]] double mean_square() const { return squares / static_cast<double>(count); }
  /// Statistics of the values times `unit`.
  [[nodiscard]] Deviation deviation(double unit) const {
    return {mean() * unit, std::sqrt(mean_square()) * unit, max * unit, count};
  }
};

/// Adds up the results of `measure(begin, end)` for the chunks of [0, count), in their order.
template <typename Accumulator>
Accumulator accumulate_in_order(
    std::int64_t count, int num_threads, const Progress& progress,
    const std::function<Accumulator(std::int64_t begin, std::int64_t end)>& measure) {
  std::vector<Accumulator> chunks((count + kSampleChunk - 1) / kSampleChunk);
  parallel_chunks(
      count, kSampleChunk, num_threads,
      [&](std::int64_t begin, std::int64_t end) {
        chunks[begin / kSampleChunk] = measure(begin, end);
      },
      progress);
  Accumulator total;
  for (const Accumulator& chunk : chunks) total.add(chunk);
  return total;
}

/// The two meshes, translated so that the centre of the original's bounding box is the origin, and
/// scaled by a power of two so that its size is near 1. Then no metric depends on the origin of a
/// file, and no product overflows or underflows because of its unit.
class NormalizedPair {
 public:
  /// @throws InputError  as check_mesh; a mesh without faces; an original whose bounding box is a
  ///                     point.
  NormalizedPair(const MeshView& original, const MeshView& simplified);
  NormalizedPair(const NormalizedPair&) = delete;
  NormalizedPair& operator=(const NormalizedPair&) = delete;
  ~NormalizedPair() = default;

  [[nodiscard]] const MeshView& original() const { return original_; }
  [[nodiscard]] const MeshView& simplified() const { return simplified_; }
  /// Diagonal of the original's bounding box, in normalised units.
  [[nodiscard]] double diagonal() const { return diagonal_; }
  /// Length of the normalised unit in the files' units.
  [[nodiscard]] double unit() const { return unit_; }

 private:
  MeshView original_;
  MeshView simplified_;
  Vertices original_vertices_;
  Vertices simplified_vertices_;
  double diagonal_ = 0.0;
  double unit_ = 1.0;
};

}  // namespace manip3d
