#include "manip3d/metrics/texture_error.hpp"

#include <algorithm>
#include <optional>
#include <vector>

#include "metrics/common.hpp"
#include "metrics/matched_samples.hpp"

namespace manip3d {
namespace {

std::int32_t material_of(const MeshView& mesh, std::int32_t face) {
  return mesh.has_materials() ? mesh.face_material[face] : -1;
}

Eigen::RowVector2d interpolated_texcoord(const MeshView& mesh, std::int32_t face,
                                         const Eigen::Vector3d& barycentric) {
  Eigen::RowVector2d uv = Eigen::RowVector2d::Zero();
  for (int k = 0; k < 3; ++k) {
    uv += barycentric[k] * mesh.texcoords.row(mesh.face_texcoords(face, k));
  }
  return uv;
}

// The nearest texture coordinates among the met faces with the same material.
struct Match {
  bool same_material = false;
  std::optional<double> distance;
};

Match best_match(const MeshView& mesh, const std::vector<SurfacePoint>& met, std::int32_t material,
                 const std::optional<Eigen::RowVector2d>& uv) {
  Match match;
  for (const SurfacePoint& candidate : met) {
    if (material_of(mesh, candidate.face) != material) continue;
    match.same_material = true;
    if (!uv || !mesh.face_has_texcoords(candidate.face)) continue;
    const double distance =
        (interpolated_texcoord(mesh, candidate.face, candidate.barycentric) - *uv).norm();
    match.distance = std::min(distance, match.distance.value_or(distance));
  }
  return match;
}

struct Counts {
  Moments differences;
  std::int64_t skipped = 0;
  std::int64_t mismatches = 0;
  std::int64_t drawn = 0;

  void add(const Match& match, bool has_uv) {
    ++drawn;
    if (!match.same_material) ++mismatches;
    if (!has_uv || (match.same_material && !match.distance)) ++skipped;
    if (match.distance) differences.add(*match.distance);
  }
  void add(const Counts& other) {
    differences.add(other.differences);
    skipped += other.skipped;
    mismatches += other.mismatches;
    drawn += other.drawn;
  }
};

}  // namespace

TextureError texture_error(const MeshView& original, const MeshView& simplified,
                           const TextureErrorOptions& options, const Progress& progress) {
  const NormalizedPair pair(original, simplified);
  const MeshView& from = pair.original();
  const MeshView& to = pair.simplified();
  const auto counts = over_matched_samples<Counts>(
      pair, {options.samples, options.seed, options.epsilon, options.num_threads}, progress,
      [&](Counts& sums, const SurfaceSample& sample, const std::vector<SurfacePoint>& met) {
        std::optional<Eigen::RowVector2d> uv;
        if (from.face_has_texcoords(sample.face)) {
          uv = interpolated_texcoord(from, sample.face, sample.barycentric);
        }
        sums.add(best_match(to, met, material_of(from, sample.face), uv), uv.has_value());
      });

  TextureError error;
  error.samples = counts.differences.count;
  error.skipped = counts.skipped;
  error.material_mismatches = counts.mismatches;
  error.material_mismatch_rate =
      static_cast<double>(counts.mismatches) / static_cast<double>(counts.drawn);
  if (error.samples == 0) return error;
  error.mean = counts.differences.mean();
  error.mse = counts.differences.mean_square();
  error.rms = std::sqrt(*error.mse);
  error.max = counts.differences.max;
  return error;
}

}  // namespace manip3d
