#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/bvh.hpp"
#include "manip3d/metrics/sampling.hpp"
#include "metrics/common.hpp"

namespace manip3d {

struct MatchOptions {
  std::int64_t samples = 0;  ///< 0: the larger number of faces of the two meshes.
  std::uint64_t seed = 0;
  double epsilon = 0.0;  ///< In diagonals of the original.
  int num_threads = 0;
};

/// Draws uniform samples of the original and calls add(counts, sample, met) for each: `met` are the
/// faces of the simplified mesh within epsilon of the distance of the closest one. Both sides of a
/// seam are equally near, so the attributes of all of them matter. The sum of the counts has the
/// same bits for any number of threads.
/// @throws InputError  epsilon not finite or < 0; an original without area.
template <typename Counts, typename Add>
Counts over_matched_samples(const NormalizedPair& pair, const MatchOptions& options,
                            const Progress& progress, const Add& add) {
  if (!(options.epsilon >= 0.0 && std::isfinite(options.epsilon))) {
    throw InputError("epsilon: expected >= 0, got " + number_text(options.epsilon));
  }
  const MeshView& from = pair.original();
  const MeshView& to = pair.simplified();
  const double reach = options.epsilon * pair.diagonal();
  const SurfaceSampler sampler(
      from, "original",
      options.samples == 0 ? std::max(from.num_faces(), to.num_faces()) : options.samples,
      options.seed);
  const TriangleBvh bvh(to, part_of(progress, 0.0, 0.3));

  const auto measure = [&](std::int64_t begin, std::int64_t end) {
    Counts counts;
    std::vector<SurfacePoint> met;
    std::int32_t near_face = 0;
    for (std::int64_t i = begin; i < end; ++i) {
      const SurfaceSample sample = sampler[i];
      const SurfacePoint nearest = bvh.closest_point(sample.point, near_face);
      near_face = nearest.face;
      // The margin includes the closest face at its own distance despite rounding.
      bvh.faces_within(sample.point, nearest.distance * (1.0 + 1e-12) + reach, met);
      add(counts, sample, met);
    }
    return counts;
  };
  return accumulate_in_order<Counts>(sampler.size(), options.num_threads,
                                     part_of(progress, 0.3, 1.0), measure);
}

}  // namespace manip3d
