#include "manip3d/metrics/sampling.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {

SurfaceSampler::SurfaceSampler(const MeshView& mesh, std::string_view name,
                               std::int64_t num_samples, std::uint64_t seed)
    : mesh_(mesh), num_samples_(num_samples), seed_(seed) {
  if (num_samples < 1) {
    throw InputError("samples: expected >= 1, got " + std::to_string(num_samples));
  }
  cumulative_area_.reserve(mesh.num_faces());
  double sum = 0.0;
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    const Eigen::Vector3d a = mesh.vertices.row(mesh.faces(f, 0));
    const Eigen::Vector3d b = mesh.vertices.row(mesh.faces(f, 1));
    const Eigen::Vector3d c = mesh.vertices.row(mesh.faces(f, 2));
    sum += (b - a).cross(c - a).norm();
    cumulative_area_.push_back(sum);
  }
  if (!(sum > 0.0 && std::isfinite(sum))) {
    throw InputError(std::string(name) +
                     ": expected a surface with an area to draw samples from, got area " +
                     number_text(0.5 * sum));
  }
}

SurfaceSample SurfaceSampler::operator[](std::int64_t i) const {
  const auto counter = 3 * static_cast<std::uint64_t>(i);
  const double position = (static_cast<double>(i) + uniform(seed_, counter)) /
                          static_cast<double>(num_samples_) * cumulative_area_.back();
  auto entry = std::upper_bound(cumulative_area_.begin(), cumulative_area_.end(), position);
  if (entry == cumulative_area_.end()) {  // due to rounding: take the last face with an area
    entry =
        std::lower_bound(cumulative_area_.begin(), cumulative_area_.end(), cumulative_area_.back());
  }
  double b = uniform(seed_, counter + 1);
  double c = uniform(seed_, counter + 2);
  if (b + c > 1.0) {  // the other half of the parallelogram
    b = 1.0 - b;
    c = 1.0 - c;
  }
  SurfaceSample sample;
  sample.face = static_cast<std::int32_t>(entry - cumulative_area_.begin());
  sample.barycentric = {1.0 - b - c, b, c};
  const auto corner = [&](int k) { return mesh_.vertices.row(mesh_.faces(sample.face, k)); };
  sample.point = corner(0) + b * (corner(1) - corner(0)) + c * (corner(2) - corner(0));
  return sample;
}

}  // namespace manip3d
