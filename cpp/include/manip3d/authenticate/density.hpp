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
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< The scanner's.
  /// Degrees, a divisor of 180: side of the sectors of azimuth and elevation in which levels are
  /// kept apart; 0: one sector.
  std::int64_t sector = 3;
  double level_width = 0.05;   ///< Metres of range.
  double level_growth = 0.01;  ///< A level is at least this share of its range wide.
  double max_range = 500.0;    ///< Metres; farther points are left out.
  /// Distances are divided by the cosine of the elevation: columns of the scanner's grid meet at
  /// the poles.
  bool level_out = true;
  int num_threads = 0;  ///< 0: all cores.
};

/// Nearest-neighbour distances by sector and level of range.
struct DensityLevels {
  std::int64_t sectors = 1;
  std::vector<double> edges;         ///< Metres; one more than there are levels.
  std::vector<std::int32_t> counts;  ///< (sectors, levels): points.
  std::vector<double> means;         ///< (sectors, levels), metres; 0 where there is no point.
};

/// Mean nearest-neighbour distance of each sector and level: the signal of IsDensityConsistent
/// (dissertation, algorithm I). Distances are summed in whole micrometres, so in any order; the
/// borders of levels hold to 5 mm.
/// @param distances  as from nearest_distances.
/// @throws InputError  what check_points refuses; another number of distances; an option out of
///                     range.
DensityLevels density_levels(const PointsView& view, std::span<const double> distances,
                             const DensityOptions& options, const Progress& progress = {});

/// Rows of the points that lie in marked cells of (sectors, levels), ascending.
/// @throws InputError  as density_levels; another number of marks.
std::vector<std::int32_t> points_of_levels(const PointsView& view,
                                           std::span<const std::uint8_t> marked,
                                           const DensityOptions& options,
                                           const Progress& progress = {});

}  // namespace manip3d
