#include "manip3d/metrics/texture_error.hpp"

#include <algorithm>
#include <optional>
#include <vector>

#include "geometry/uv_charts.hpp"
#include "metrics/common.hpp"
#include "metrics/matched_samples.hpp"

namespace manip3d {
namespace {

/// Texture coordinates are inside a chart if they are at most this far outside, relative to the
/// part of the texture that a material shows; files in single precision round that much.
constexpr double kRounding = 1e-6;

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

struct Outside {
  std::int64_t outside = 0;
  std::int64_t drawn = 0;

  void add(const Outside& other) {
    outside += other.outside;
    drawn += other.drawn;
  }
};

bool has_area(const MeshView& mesh) {
  for (std::int64_t f = 0; f < mesh.num_faces(); ++f) {
    const Eigen::RowVector3d a = mesh.vertices.row(mesh.faces(f, 0));
    const Eigen::RowVector3d b = mesh.vertices.row(mesh.faces(f, 1)) - a;
    if (b.cross(mesh.vertices.row(mesh.faces(f, 2)) - a).norm() > 0.0) return true;
  }
  return false;
}

/// The share of uniform samples of the textured part of `simplified` whose texture coordinates no
/// face of the original with the same material has; no value if there are no such samples.
std::optional<double> outside_charts(const MeshView& original, const MeshView& simplified,
                                     const TextureErrorOptions& options, const Progress& progress) {
  if (!simplified.has_texcoords() || !has_area(simplified)) return std::nullopt;
  std::vector<std::int32_t> material(static_cast<std::size_t>(original.num_faces()), -1);
  for (std::int32_t f = 0; f < std::ssize(material); ++f) {
    if (original.face_has_texcoords(f)) material[f] = material_of(original, f) + 1;
  }
  const UvCharts charts(original, material, part_of(progress, 0.0, 0.5));
  const std::int64_t samples = std::max(original.num_faces(), simplified.num_faces());
  const SurfaceSampler sampler(simplified, "simplified",
                               options.samples == 0 ? samples : options.samples, options.seed);
  const auto measure = [&](std::int64_t begin, std::int64_t end) {
    Outside counts;
    for (std::int64_t i = begin; i < end; ++i) {
      const SurfaceSample sample = sampler[i];
      if (!simplified.face_has_texcoords(sample.face)) continue;
      const auto uv = interpolated_texcoord(simplified, sample.face, sample.barycentric);
      const auto nearest = charts.nearest(material_of(simplified, sample.face) + 1, uv.transpose());
      ++counts.drawn;
      if (!nearest || !(nearest->distance <= kRounding)) ++counts.outside;
    }
    return counts;
  };
  const Outside counts = accumulate_in_order<Outside>(sampler.size(), options.num_threads,
                                                      part_of(progress, 0.5, 1.0), measure);
  if (counts.drawn == 0) return std::nullopt;
  return static_cast<double>(counts.outside) / static_cast<double>(counts.drawn);
}

}  // namespace

TextureError texture_error(const MeshView& original, const MeshView& simplified,
                           const TextureErrorOptions& options, const Progress& progress) {
  const NormalizedPair pair(original, simplified);
  const MeshView& from = pair.original();
  const MeshView& to = pair.simplified();
  const auto counts = over_matched_samples<Counts>(
      pair, {options.samples, options.seed, options.epsilon, options.num_threads},
      part_of(progress, 0.0, 0.8),
      [&](Counts& sums, const SurfaceSample& sample, const std::vector<SurfacePoint>& met) {
        std::optional<Eigen::RowVector2d> uv;
        if (from.face_has_texcoords(sample.face)) {
          uv = interpolated_texcoord(from, sample.face, sample.barycentric);
        }
        sums.add(best_match(to, met, material_of(from, sample.face), uv), uv.has_value());
      });

  TextureError error;
  error.outside_charts = outside_charts(from, to, options, part_of(progress, 0.8, 1.0));
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
