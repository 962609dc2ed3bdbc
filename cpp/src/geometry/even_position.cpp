#include "geometry/even_position.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <span>
#include <utility>

#include "geometry/constants.hpp"
#include "geometry/kd_tree.hpp"
#include "geometry/median.hpp"
#include "geometry/small_solvers.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

// Binary logarithm, to 1e-7, without libm.
double binary_log(double x) {
  int exponent = 0;
  const double m = std::frexp(x, &exponent);  // in [0.5, 1)
  const double t = (m - std::numbers::sqrt2 / 2.0) / (m + std::numbers::sqrt2 / 2.0);
  const double s = t * t;
  const double atanh = t * (1.0 + s * (1.0 / 3.0 + s * (1.0 / 5.0 + s * (1.0 / 7.0 + s / 9.0))));
  return exponent - 0.5 + 2.0 * atanh / std::numbers::ln2;
}

// Measures how unevenly a scanner at a position would have sampled the patches.
class Unevenness {
 public:
  Unevenness(const std::vector<SurfacePatch>& patches, int axis, const Progress& progress)
      : patches_(patches), axis_(axis), ticker_(progress, 1U << 5) {}

  // Mean absolute deviation, from its median, of log2(points of a patch / points that the grid
  // would put there): 0 at the true position, except for noise. A patch of area A at range r whose
  // normal forms an angle t with the ray covers a solid angle of A cos t / r^2; a cell of the grid
  // covers step^2 rho / r, where rho is the distance from the polar axis. Therefore density r rho /
  // cos t is constant. Only the first `most` patches are used.
  double at(const Vector3d& origin, std::size_t most) {
    constexpr double kMost = 2.2;      // octaves; larger deviations are clamped
    constexpr double kGrazing = 0.03;  // smallest cosine
    ticker_.tick();
    logs_.clear();
    for (const SurfacePatch& patch : std::span(patches_.data(), std::min(most, patches_.size()))) {
      const Vector3d ray = patch.place - origin;
      const double range = ray.norm() + 1e-6;
      const double rho =
          std::sqrt(std::max(0.0, ray.squaredNorm() - ray[axis_] * ray[axis_])) + 1e-6;
      const double cosine = std::max(std::abs(patch.normal.dot(ray)) / range, kGrazing);
      logs_.push_back(binary_log(patch.density * range * rho / cosine));
    }
    reordered_ = logs_;
    const double middle = median(std::span(reordered_));
    double sum = 0.0;
    for (const double value : logs_) sum += std::min(std::abs(value - middle), kMost);
    return sum / static_cast<double>(logs_.size());
  }

  double at(const Vector3d& origin) { return at(origin, patches_.size()); }

 private:
  const std::vector<SurfacePatch>& patches_;
  int axis_;
  Ticker ticker_;
  std::vector<double> logs_, reordered_;
};

// A box around the densest surfaces, which are the nearest to the scanner.
struct PatchBox {
  Vector3d middle, extent;
};

PatchBox dense_box(const std::vector<SurfacePatch>& patches, double smallest) {
  std::vector<double> densities;
  for (const SurfacePatch& patch : patches) densities.push_back(patch.density);
  std::sort(densities.begin(), densities.end());
  const double dense = densities[densities.size() * 4 / 5];
  PatchBox box;
  for (int a = 0; a < 3; ++a) {
    std::vector<double> values;
    for (const SurfacePatch& patch : patches) {
      if (patch.density >= dense) values.push_back(patch.place[a]);
    }
    std::sort(values.begin(), values.end());
    const double low = values[values.size() / 50];
    const double high = values[values.size() - 1 - values.size() / 50];
    box.middle[a] = 0.5 * (low + high);
    box.extent[a] = high - low;
  }
  box.extent = box.extent.cwiseMax(std::max(0.2 * box.extent.maxCoeff(), smallest));
  return box;
}

struct RatedPlace {
  double unevenness = 0.0;
  Vector3d position = Vector3d::Zero();
};

// The positions with the least unevenness on a coarse grid of 1.5 extents around a box, the best
// first.
std::vector<RatedPlace> best_of_block(const PatchBox& box, Unevenness& unevenness) {
  constexpr int kSide = 9;
  // Few patches rule out most positions of the grid. In 14 clouds the result is that of all patches
  // at all positions and of six starts, to the last digit.
  constexpr std::size_t kFewPatches = 200;
  constexpr int kLikely = 60;
  constexpr int kStarts = 2;
  const auto position_of = [&](int index) {
    const Vector3d cell(index / (kSide * kSide), index / kSide % kSide, index % kSide);
    const Vector3d share = 1.5 * (cell / (kSide - 1.0) - Vector3d::Constant(0.5));
    return Vector3d(box.middle + share.cwiseProduct(box.extent));
  };
  std::vector<std::pair<double, int>> tried;  // ties go to the lower index
  for (int i = 0; i < kSide * kSide * kSide; ++i) {
    tried.emplace_back(unevenness.at(position_of(i), kFewPatches), i);
  }
  std::partial_sort(tried.begin(), tried.begin() + kLikely, tried.end());
  tried.resize(kLikely);
  for (auto& [found, index] : tried) found = unevenness.at(position_of(index));
  std::partial_sort(tried.begin(), tried.begin() + kStarts, tried.end());
  std::vector<RatedPlace> places;
  for (int s = 0; s < kStarts; ++s) {
    places.push_back({tried[s].first, position_of(tried[s].second)});
  }
  return places;
}

// Descends along the axes to less uneven positions, with steps that are halved repeatedly. The
// number of sweeps per step is limited, because the measure of a cloud that is no scan may have no
// minimum.
RatedPlace descend(RatedPlace here, const Vector3d& first_step, double smallest,
                   Unevenness& unevenness) {
  constexpr int kSweeps = 16;  // per step size
  for (Vector3d step = first_step; step.maxCoeff() > smallest; step /= 2.0) {
    bool better = true;
    for (int sweep = 0; better && sweep < kSweeps; ++sweep) {
      better = false;
      for (int move = 0; move < 6; ++move) {
        Vector3d next = here.position;
        next[move / 2] += move % 2 == 0 ? step[move / 2] : -step[move / 2];
        const double other = unevenness.at(next);
        if (other < here.unevenness) here = {other, next}, better = true;
      }
    }
  }
  return here;
}

}  // namespace

std::vector<SurfacePatch> sample_patches(const Points& points, const Progress& progress) {
  constexpr std::int64_t kPatches = 1500;
  constexpr std::size_t kNeighbours = 24;
  constexpr double kLine =
      // If the middle spread is below this share of the largest one, the points are on a line.
      0.15;
  const PointsView view{{points.data(), points.rows(), 3}};
  const KdTree tree(view, progress);
  KdTree::Neighbours near;
  std::vector<SurfacePatch> patches;
  for (std::int64_t k = 0; k < kPatches; ++k) {
    const auto row = static_cast<std::int64_t>(uniform(1, k) * static_cast<double>(points.rows()));
    tree.nearest(row, kNeighbours, near);
    Eigen::Matrix<double, Eigen::Dynamic, 3> around(near.rows.size(), 3);
    for (std::size_t i = 0; i < near.rows.size(); ++i) {
      around.row(static_cast<Eigen::Index>(i)) = points.row(near.rows[i]).cast<double>();
    }
    around.rowwise() -= around.colwise().mean().eval();
    const Eigen::Matrix3d spread = around.transpose() * around;
    const PrincipalAxes axes = principal_axes(spread);
    const double area = kPi * near.squared_distances.back();
    if (!(area > 0.0 && axes.spreads[1] > kLine * axes.spreads[2])) continue;
    patches.push_back({points.row(row).cast<double>().transpose(), axes.directions.col(0),
                       static_cast<double>(near.rows.size()) / area});
  }
  return patches;
}

Vector3d even_position(const std::vector<SurfacePatch>& patches, int axis,
                       const Progress& progress) {
  constexpr double kSmallest = 0.002;      // metres
  constexpr double kSmallestShare = 1e-5;  // or this share of the extent
  const PatchBox box = dense_box(patches, kSmallest);
  const double smallest = std::max(kSmallest, kSmallestShare * box.extent.maxCoeff());
  Unevenness unevenness(patches, axis, progress);
  const std::vector<RatedPlace> starts = best_of_block(box, unevenness);
  RatedPlace best = starts.front();
  for (const RatedPlace& start : starts) {
    const RatedPlace found = descend(start, box.extent / 8.0, smallest, unevenness);
    if (found.unevenness < best.unevenness) best = found;
  }
  return best.position;
}

}  // namespace manip3d
