#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string_view>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

struct SurfaceSample {
  std::int32_t face = -1;
  Eigen::Vector3d barycentric;  ///< Weights of the face's corners.
  Eigen::Vector3d point;
};

/// Uniformly distributed random points of a surface, one in each of `num_samples` strata of equal
/// area.
///
/// The strata follow the order of the faces, so consecutive samples are near each other. Sample i
/// depends only on (mesh, num_samples, seed, i), so any thread may compute any sample. Faces
/// without area have no samples. The view must outlive the sampler. 8 bytes per face.
class SurfaceSampler {
 public:
  /// `name` is that of the mesh in errors.
  /// @throws InputError  num_samples < 1; a surface without area, or whose area overflows a double.
  SurfaceSampler(const MeshView& mesh, std::string_view name, std::int64_t num_samples,
                 std::uint64_t seed);

  [[nodiscard]] SurfaceSample operator[](std::int64_t i) const;
  [[nodiscard]] std::int64_t size() const { return num_samples_; }

 private:
  const MeshView& mesh_;
  std::int64_t num_samples_;
  std::uint64_t seed_;
  std::vector<double> cumulative_area_;  // doubled
};

}  // namespace manip3d
