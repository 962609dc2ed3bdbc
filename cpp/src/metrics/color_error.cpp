#include "manip3d/metrics/color_error.hpp"

#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "metrics/common.hpp"
#include "metrics/matched_samples.hpp"

namespace manip3d {
namespace {

void expect_colors(const MeshView& mesh, const char* name) {
  if (mesh.colors.rows() != mesh.num_vertices()) {
    throw InputError(std::string(name) + ": expected a mesh with colours of vertices");
  }
}

Eigen::RowVector3d interpolated_color(const MeshView& mesh, std::int32_t face,
                                      const Eigen::Vector3d& barycentric) {
  Eigen::RowVector3d color = Eigen::RowVector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    color += barycentric[k] * mesh.colors.row(mesh.faces(face, k)).cast<double>();
  }
  return color;
}

}  // namespace

ColorError color_error(const MeshView& original, const MeshView& simplified,
                       const ColorErrorOptions& options, const Progress& progress) {
  expect_colors(original, "original");
  expect_colors(simplified, "simplified");
  const NormalizedPair pair(original, simplified);
  const MeshView& from = pair.original();
  const MeshView& to = pair.simplified();
  const auto differences = over_matched_samples<Moments>(
      pair, {options.samples, options.seed, options.epsilon, options.num_threads}, progress,
      [&](Moments& sums, const SurfaceSample& sample, const std::vector<SurfacePoint>& met) {
        const Eigen::RowVector3d color = interpolated_color(from, sample.face, sample.barycentric);
        double squares = std::numeric_limits<double>::infinity();
        for (const SurfacePoint& candidate : met) {
          const Eigen::RowVector3d other =
              interpolated_color(to, candidate.face, candidate.barycentric);
          squares = std::min(squares, (other - color).squaredNorm());
        }
        sums.add(std::sqrt(squares / 3.0));
      });
  return {differences.mean(), std::sqrt(differences.mean_square()), differences.max,
          differences.count};
}

}  // namespace manip3d
