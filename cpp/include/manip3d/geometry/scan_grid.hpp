#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Cells of equal azimuth and elevation around a scanner: an equirectangular image. Row 0 is the
/// lowest, column 0 starts at azimuth -180 degrees, give or take the phase.
struct ScanGrid {
  double azimuth_step = 0.0;     ///< Radians.
  double elevation_step = 0.0;   ///< Radians.
  double azimuth_phase = 0.0;    ///< Radians: the centre of some column.
  double elevation_phase = 0.0;  ///< Radians: the centre of some row.

  /// How sharply the scan's angles stand on the grid: autocorrelation of their histogram at the
  /// step, 0 to 1; 0 where the step comes from the density of points instead.
  double azimuth_strength = 0.0;
  double elevation_strength = 0.0;

  [[nodiscard]] std::int64_t columns() const;
  [[nodiscard]] std::int64_t rows() const;
};

/// Finds the angular grid of a scan: the period of its azimuths and of its elevations, from the
/// autocorrelation of their histograms (0.002 degree bins for up to 2 million of the points, 0.01
/// degree bins below 500 000 points). An angle without a period gets the step at which a cell holds
/// one point on average.
/// @throws InputError  what check_points refuses; an origin that is not finite.
ScanGrid estimate_scan_grid(const PointsView& view, const Eigen::Vector3d& origin,
                            int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
