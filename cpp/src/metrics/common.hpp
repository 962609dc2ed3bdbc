#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <new>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/metrics/metro.hpp"

/// @file
/// What the measures share: checks, centring, sums in a fixed order.
namespace manip3d {

constexpr std::int64_t kSampleChunk = 1024;

/// Sum, sum of squares and maximum; those of chunks are combined in chunk order, so that the result
/// does not depend on the number of threads.
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
  [[nodiscard]] double mean() const { return sum / static_cast<double>(count); }  // none: NaN
  [[nodiscard]] double mean_square() const { return squares / static_cast<double>(count); }
  /// The values times `unit`.
  [[nodiscard]] Deviation deviation(double unit) const {
    if (count == 0) return {};
    return {mean() * unit, std::sqrt(mean_square()) * unit, max * unit, count};
  }
};

/// Runs `measure(i, accumulator)` for each i in [0, count), one accumulator a chunk, and adds them
/// up in chunk order.
template <typename Accumulator, typename Measure>
Accumulator accumulate_in_order(std::int64_t count, int num_threads, const Progress& progress,
                                const Measure& measure) {
  std::vector<Accumulator> chunks((count + kSampleChunk - 1) / kSampleChunk);
  parallel_chunks(
      count, kSampleChunk, num_threads,
      [&](std::int64_t begin, std::int64_t end) {
        Accumulator chunk;
        for (std::int64_t i = begin; i < end; ++i) measure(i, chunk);
        chunks[begin / kSampleChunk] = chunk;
      },
      progress);
  Accumulator total;
  for (const Accumulator& chunk : chunks) total.add(chunk);
  return total;
}

/// Maps a part of the work to the range [from, to] of the whole's progress.
inline Progress part_of(const Progress& progress, double from, double to) {
  if (!progress) return {};
  return [=](double fraction) { progress(from + fraction * (to - from)); };
}

/// The two meshes moved so that the middle of the original's bounding box is the origin: samples
/// of surfaces far from the origin would otherwise be rounded to the coordinates' last place.
class CenteredPair {
 public:
  /// @throws InputError  what check_mesh refuses; a mesh without faces; a diagonal of the original
  ///                     that is 0 or no double.
  CenteredPair(const MeshView& original, const MeshView& simplified)
      : original_(original), simplified_(simplified) {
    check_mesh(original);
    check_mesh(simplified);
    const BoundingBox box = bounding_box(original);
    diagonal_ = box.diagonal();
    for (const auto& [name, mesh] :
         {std::pair{"original", &original}, std::pair{"simplified", &simplified}}) {
      if (mesh->num_faces() > 0) continue;
      throw InputError(std::string(name) + ": expected at least one face, got none");
    }
    if (!(diagonal_ > 0.0 && std::isfinite(diagonal_))) {
      throw InputError("original: expected a bounding box with a diagonal > 0, got " +
                       std::to_string(diagonal_));
    }
    move(original_, original_vertices_, box.center());
    move(simplified_, simplified_vertices_, box.center());
  }
  CenteredPair(const CenteredPair&) = delete;
  CenteredPair& operator=(const CenteredPair&) = delete;
  ~CenteredPair() = default;

  [[nodiscard]] const MeshView& original() const { return original_; }
  [[nodiscard]] const MeshView& simplified() const { return simplified_; }
  [[nodiscard]] double diagonal() const { return diagonal_; }

 private:
  static void move(MeshView& view, Vertices& moved, const Eigen::Vector3d& center) {
    moved = view.vertices.rowwise() - center.transpose();
    using Map = MeshView::Map<Vertices>;
    new (&view.vertices) Map(moved.data(), moved.rows(), 3);  // Eigen's way to rebind a map
  }

  MeshView original_;
  MeshView simplified_;
  Vertices original_vertices_;
  Vertices simplified_vertices_;
  double diagonal_ = 0.0;
};

}  // namespace manip3d
