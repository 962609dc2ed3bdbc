#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Cells of equal azimuth and elevation around a scanner: an equirectangular image. Row 0 is the
/// lowest; column 0 starts at an azimuth of -180 degrees plus the phase.
struct ScanGrid {
  double azimuth_step = 0.0;     ///< Radians.
  double elevation_step = 0.0;   ///< Radians.
  double azimuth_phase = 0.0;    ///< Radians: the centre of some column.
  double elevation_phase = 0.0;  ///< Radians: the centre of some row.

  /// Sharpness of the grid: autocorrelation of the histogram of angles at the step, 0 to 1; 0 if
  /// the step was estimated from the density of points.
  double azimuth_strength = 0.0;
  double elevation_strength = 0.0;

  [[nodiscard]] std::int64_t columns() const;
  [[nodiscard]] std::int64_t rows() const;
};

/// Estimate the angular grid of a scan: the period of its azimuths and that of its elevations, from
/// the autocorrelation of their histograms (0.002 degree bins for up to 2 million of the points,
/// 0.01 degree bins below 500 000 points). For an angle without a period, the step is chosen so
/// that a cell contains one point on average.
/// @throws InputError  as check_points; an origin that is not finite.
ScanGrid estimate_scan_grid(const PointsView& view, const Eigen::Vector3d& origin,
                            int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
