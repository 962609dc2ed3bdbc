#include "manip3d/metrics/metro.hpp"

#include <string_view>
#include <vector>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/metrics/sampling.hpp"
#include "metrics/common.hpp"

namespace manip3d {
namespace {

std::vector<std::int32_t> used_vertices(const MeshView& mesh) {
  std::vector<bool> is_used(mesh.num_vertices());
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    for (int k = 0; k < 3; ++k) is_used[mesh.faces(f, k)] = true;
  }
  std::vector<std::int32_t> used;
  for (std::size_t v = 0; v < is_used.size(); ++v) {
    if (is_used[v]) used.push_back(static_cast<std::int32_t>(v));
  }
  return used;
}

Deviation one_sided(const MeshView& from, std::string_view name, const MeshView& to, double unit,
                    std::int64_t samples, const MetroOptions& options, const Progress& progress) {
  constexpr double kBuilt = 0.3;  // share of the time for building the tree
  const TriangleBvh bvh(to, part_of(progress, 0.0, kBuilt));
  const auto measure_all = [&](std::int64_t count, const auto& point_of) {
    const auto measure = [&](std::int64_t begin, std::int64_t end) {
      Moments distances;
      std::int32_t near_face = 0;  // consecutive samples have near answers
      for (std::int64_t i = begin; i < end; ++i) {
        const SurfacePoint nearest = bvh.closest_point(point_of(i), near_face);
        distances.add(nearest.distance);
        near_face = nearest.face;
      }
      return distances;
    };
    return accumulate_in_order<Moments>(count, options.num_threads, part_of(progress, kBuilt, 1.0),
                                        measure)
        .deviation(unit);
  };
  if (options.sampling == Sampling::kVertex) {
    const std::vector<std::int32_t> used = used_vertices(from);
    return measure_all(static_cast<std::int64_t>(used.size()),
                       [&](std::int64_t i) { return Eigen::Vector3d(from.vertices.row(used[i])); });
  }
  const SurfaceSampler sampler(from, name, samples, options.seed);
  return measure_all(sampler.size(), [&](std::int64_t i) { return sampler[i].point; });
}

}  // namespace

MetroResult metro(const MeshView& original, const MeshView& simplified, const MetroOptions& options,
                  const Progress& progress) {
  const NormalizedPair pair(original, simplified);
  const std::int64_t samples = options.samples == 0 ? 10 * original.num_faces() : options.samples;
  MetroResult result;
  result.diagonal = pair.diagonal() * pair.unit();
  result.forward = one_sided(pair.original(), "original", pair.simplified(), pair.unit(), samples,
                             options, part_of(progress, 0.0, 0.5));
  result.backward = one_sided(pair.simplified(), "simplified", pair.original(), pair.unit(),
                              samples, options, part_of(progress, 0.5, 1.0));
  return result;
}

}  // namespace manip3d
