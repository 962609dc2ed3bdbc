#include "authenticate/drift_windows.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

#include "geometry/median.hpp"

namespace manip3d {
namespace {

// Windows reach this many rows of cells and columns to each side.
constexpr int kDriftRows = 1;
constexpr int kDriftColumns = 2;
// Fewer points do not tell the mean of a window, and fewer windows not the spread of all, which is
// the unit of the deviations.
constexpr std::int32_t kMinDrifting = 8;
constexpr std::size_t kMinDriftWindows = 1000;
// 1 / sqrt(12): standard deviation of a uniform distribution of width 1
constexpr double kRoundingShare = 0.2887;

struct DriftTally {
  std::int32_t points = 0;
  float error = 0.0F;  // metres, summed
  // metres, summed: standard error of the line, which all points of a laser share
  float doubt = 0.0F;
};

// Sums of line errors by voxel, without the mean of each laser.
std::vector<DriftTally> drift_tallies(const PointsView& points, const LatticeReading& reading,
                                      const ScanLattice& lattice, std::size_t num_voxels,
                                      const std::vector<std::int32_t>& voxel_of_point,
                                      const std::vector<double>& means) {
  std::vector<DriftTally> tallies(num_voxels);
  for (std::int32_t i = 0; i < points.num_points(); ++i) {
    if (!is_near_line(reading, i)) continue;
    const auto ring = static_cast<std::size_t>(reading.ring(i));
    const Eigen::RowVector2d p = points.points.row(i).head<2>().cast<double>();
    DriftTally& tally = tallies[voxel_of_point[i]];
    ++tally.points;
    tally.error += static_cast<float>(reading.line_error(i) - means[ring]);
    // Ring::uncertainty() is 4 standard deviations.
    tally.doubt += static_cast<float>(
        0.25 * lattice.rings[ring].uncertainty(std::sqrt(p.x() * p.x() + p.y() * p.y())));
  }
  return tallies;
}

DriftTally drift_window(const std::vector<DriftTally>& tallies, const RangeVoxels& voxels,
                        const RangeVoxel& at) {
  DriftTally sum;
  const int columns = voxels.columns();
  for (int r = std::max(0, at.row - kDriftRows);
       r <= std::min(voxels.rows() - 1, at.row + kDriftRows); ++r) {
    for (int d = -kDriftColumns; d <= kDriftColumns; ++d) {
      const int column = at.column + d;
      const int wrapped = column < 0 ? column + columns : column;
      const std::int32_t number =
          voxels.find({r, wrapped < columns ? wrapped : wrapped - columns, at.layer});
      if (number < 0) continue;
      const DriftTally& tally = tallies[number];
      sum.points += tally.points;
      sum.error += tally.error;
      sum.doubt += tally.doubt;
    }
  }
  return sum;
}

}  // namespace

std::vector<double> mean_line_errors(const LatticeReading& reading, std::size_t num_lasers) {
  std::vector<std::int32_t> points(num_lasers, 0);
  std::vector<double> means(num_lasers, 0.0);
  for (std::int32_t i = 0; i < reading.ring.size(); ++i) {
    if (!is_near_line(reading, i)) continue;
    ++points[reading.ring(i)];
    means[reading.ring(i)] += reading.line_error(i);
  }
  for (std::size_t ring = 0; ring < means.size(); ++ring) means[ring] /= std::max(points[ring], 1);
  return means;
}

std::vector<float> drift_deviations(const PointsView& points, const LatticeReading& reading,
                                    const ScanLattice& lattice, const RangeVoxels& voxels,
                                    const std::vector<std::int32_t>& voxel_of_point,
                                    const std::vector<double>& means) {
  const double rounding = kRoundingShare * lattice.coordinate_step;
  const std::vector<DriftTally> tallies =
      drift_tallies(points, reading, lattice, voxels.size(), voxel_of_point, means);
  std::vector<float> deviations(voxels.size(), 0.0F);
  std::vector<float> sizes;
  for (std::size_t k = 0; k < voxels.size(); ++k) {
    if (tallies[k].points == 0) continue;
    const DriftTally sum = drift_window(tallies, voxels, voxels.voxels()[k]);
    if (sum.points < kMinDrifting) continue;
    const double doubt = sum.doubt;
    const double spread = std::sqrt(sum.points * rounding * rounding + doubt * doubt);
    deviations[k] = static_cast<float>(sum.error / spread);
    sizes.push_back(std::abs(deviations[k]));
  }
  const bool enough = sizes.size() >= kMinDriftWindows;
  const double common = enough ? std::max(1.0, kNormalMad * median(std::span(sizes))) : 0.0;
  for (float& deviation : deviations) {
    deviation = enough ? static_cast<float>(deviation / common) : 0.0F;
  }
  return deviations;
}

}  // namespace manip3d
