#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct DensityOptions {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< Position of the scanner, metres.
  /// Degrees, a divisor of 180: width and height of the sectors of azimuth and elevation, each of
  /// which has its own levels; 0: one sector.
  std::int64_t sector = 3;
  double level_width = 0.05;   ///< Metres of range: least width of a level.
  double level_growth = 0.01;  ///< Least width of a level as a share of its range.
  double max_range = 500.0;    ///< Metres; farther points are left out.
  /// Divide distances by the cosine of the elevation, because the columns of the scanner's grid
  /// converge towards the poles.
  bool level_out = true;
  int num_threads = 0;  ///< 0: all cores.
};

/// Nearest-neighbour distances by sector and level of range.
struct DensityLevels {
  std::int64_t sectors = 1;
  std::vector<double> edges;         ///< Metres: borders of the levels, one more than levels.
  std::vector<std::int32_t> counts;  ///< (sectors, levels): numbers of points.
  std::vector<double> means;         ///< (sectors, levels), metres; 0 if there are no points.
};

/// Returns the mean nearest-neighbour distance of each sector and level: the signal of
/// IsDensityConsistent (dissertation, algorithm I). Distances are summed in whole micrometres, so
/// that the order of the points does not matter. Borders of levels are exact to 5 mm.
/// @param distances  (N,) nearest-neighbour distances of the points, metres, from
///                   nearest_distances().
/// @throws InputError  the points fail check_points; another number of distances; an option out of
///                     range.
DensityLevels density_levels(const PointsView& view, std::span<const double> distances,
                             const DensityOptions& options, const Progress& progress = {});

/// Returns the row numbers, ascending, of the points in marked cells of (sectors, levels).
/// @throws InputError  as density_levels; another number of marks.
std::vector<std::int32_t> points_of_levels(const PointsView& view,
                                           std::span<const std::uint8_t> marked,
                                           const DensityOptions& options,
                                           const Progress& progress = {});

}  // namespace manip3d
