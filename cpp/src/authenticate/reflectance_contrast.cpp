#include "manip3d/authenticate/reflectance_contrast.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kApart = 2;  // rows from the first point of a pair to the second
constexpr float kWidth = 0.0125F;   // radians: largest difference of azimuth within a pair
// one in this many pairs on surfaces is used, because there are plenty
constexpr std::int64_t kEverySurface = 3;
constexpr float kMaxDifferent = 0.3F;

// Limits of the range difference of a pair: metres plus a share of the nearer range. A smaller
// difference is one surface, a larger one is an edge.
constexpr float kSurfaceMetres = 0.02F;
constexpr float kSurfaceShare = 0.01F;
constexpr float kEdgeMetres = 0.3F;
constexpr float kEdgeShare = 0.1F;

// First rows of the pairs of each kind.
struct Pairs {
  std::vector<std::int64_t> edges, surfaces;
};

Pairs find_pairs(const PointsView& points, std::span<const std::int32_t> rings,
                 std::span<const float> azimuths) {
  const Eigen::VectorXf ranges = points.points.rowwise().norm();
  Pairs pairs;
  std::int64_t on_surface = 0;
  for (std::int64_t i = 0; i + kApart < points.num_points(); ++i) {
    const std::int64_t j = i + kApart;
    if (rings[i] < 0 || rings[i] != rings[j]) continue;
    if (!(std::abs(azimuths[j] - azimuths[i]) < kWidth)) continue;
    const float near = std::min(ranges[i], ranges[j]);
    const float apart = std::abs(ranges[j] - ranges[i]);
    if (apart > kEdgeShare * near + kEdgeMetres) {
      pairs.edges.push_back(i);
    } else if (apart < kSurfaceShare * near + kSurfaceMetres && on_surface++ % kEverySurface == 0) {
      pairs.surfaces.push_back(i);
    }
  }
  return pairs;
}

// Reflectances as shares of the frame's scale, with a cyclic shift along the rows of the file.
class ScaledReflectances {
 public:
  explicit ScaledReflectances(const Intensities& values) : values_(values) {
    const float smallest = values_.minCoeff();
    const float scale = values_.maxCoeff() - smallest;
    values_.array() = (values_.array() - smallest) / (scale > 0.0F ? scale : 1.0F);
  }

  [[nodiscard]] double mean_square(const std::vector<std::int64_t>& first,
                                   std::int64_t slip) const {
    double sum = 0.0;
    for (const std::int64_t row : first) {
      const float apart = std::abs(slipped(row + slip) - slipped(row + kApart + slip));
      const float clipped = std::min(apart, kMaxDifferent);
      sum += static_cast<double>(clipped * clipped);
    }
    return sum / static_cast<double>(first.size());
  }

 private:
  [[nodiscard]] float slipped(std::int64_t row) const {
    const std::int64_t size = values_.size();
    if (row >= size) return values_[row % size];
    return values_[row >= 0 ? row : size - 1 - (-row - 1) % size];
  }

  Eigen::VectorXf values_;
};

}  // namespace

ReflectanceContrast reflectance_contrast(const PointsView& points,
                                         std::span<const std::int32_t> rings,
                                         std::span<const float> azimuths,
                                         std::span<const std::int64_t> slips) {
  check_points(points);
  const auto count = static_cast<std::size_t>(points.num_points());
  if (static_cast<std::size_t>(points.intensity.size()) != count) {
    throw InputError("reflectance: expected " + std::to_string(count) + " values, got " +
                     std::to_string(points.intensity.size()));
  }
  if (rings.size() != count || azimuths.size() != count) {
    throw InputError("rings, azimuths: expected " + std::to_string(count) + " values each");
  }
  ReflectanceContrast found;
  found.contrast.assign(slips.size(), 0.0);
  const Pairs pairs = find_pairs(points, rings, azimuths);
  found.edges = static_cast<std::int64_t>(pairs.edges.size());
  found.surfaces = static_cast<std::int64_t>(pairs.surfaces.size());
  if (pairs.edges.empty() || pairs.surfaces.empty()) return found;
  const ScaledReflectances reflectances(points.intensity);
  for (std::size_t k = 0; k < slips.size(); ++k) {
    const double on_surfaces = reflectances.mean_square(pairs.surfaces, slips[k]);
    if (!(on_surfaces > 0.0)) continue;
    found.contrast[k] = reflectances.mean_square(pairs.edges, slips[k]) / on_surfaces;
  }
  return found;
}

}  // namespace manip3d
