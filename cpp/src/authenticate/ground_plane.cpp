#include "authenticate/ground_plane.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "geometry/small_solvers.hpp"

namespace manip3d {
namespace {

constexpr Eigen::Index kStride = 8;  // every eighth point is used, which is enough for a plane
constexpr double kNearest = 4.0;     // metres; nearer points are of the vehicle itself
constexpr double kFarthest = 25.0;
constexpr double kLowest = -4.0;  // metres below the scanner
constexpr double kHighest = -0.5;
constexpr double kBin = 0.1;  // metres of height
// metres: half width of the band in each step
constexpr std::array<double, 5> kBands = {0.4, 0.3, 0.2, 0.15, 0.15};
constexpr std::size_t kFewest = 200;  // least number of points in the band

std::vector<Eigen::Vector3d> candidates(const PointsView& points) {
  std::vector<Eigen::Vector3d> found;
  for (Eigen::Index i = 0; i < points.num_points(); i += kStride) {
    const Eigen::Vector3d p = points.points.row(i).cast<double>();
    const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
    if (rho > kNearest && rho < kFarthest && p.z() > kLowest && p.z() < kHighest) {
      found.push_back(p);
    }
  }
  return found;
}

double most_frequent_height(const std::vector<Eigen::Vector3d>& points) {
  std::array<int, static_cast<std::size_t>((kHighest - kLowest) / kBin) + 1> counts{};
  for (const auto& p : points) ++counts[static_cast<std::size_t>((p.z() - kLowest) / kBin)];
  const auto most = std::max_element(counts.begin(), counts.end()) - counts.begin();
  return kLowest + (static_cast<double>(most) + 0.5) * kBin;
}

}  // namespace

std::optional<GroundPlane> find_ground_plane(const PointsView& points) {
  const std::vector<Eigen::Vector3d> low = candidates(points);
  GroundPlane plane{0.0, 0.0, most_frequent_height(low)};
  for (const double band : kBands) {
    Eigen::Matrix3d gram = Eigen::Matrix3d::Zero();  // matrix of the normal equations
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    std::size_t agreeing = 0;
    for (const auto& p : low) {
      if (!(std::abs(plane.above(p.x(), p.y(), p.z())) < band)) continue;
      const Eigen::Vector3d row(p.x(), p.y(), 1.0);
      gram += row * row.transpose();
      right += row * p.z();
      ++agreeing;
    }
    if (agreeing < kFewest) return std::nullopt;
    const Eigen::Vector3d solution = solve_symmetric(gram, right);
    if (!solution.allFinite()) return std::nullopt;
    plane = {solution.x(), solution.y(), solution.z()};
  }
  return plane;
}

}  // namespace manip3d
