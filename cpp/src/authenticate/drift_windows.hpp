#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "authenticate/range_windows.hpp"
#include "manip3d/authenticate/lattice.hpp"

namespace manip3d {

/// Is a point so near to its laser's line that it counts in the mean of its window? A point farther
/// away is evidence itself (Evidence::kLine).
inline bool is_near_line(const LatticeReading& reading, std::int32_t point) {
  constexpr double kGate = 0.0012;  // metres
  return reading.ring(point) >= 0 && std::abs(reading.line_error(point)) < kGate;
}

/// Mean line error of each laser over the points near its line, metres; 0 for a laser without any.
std::vector<double> mean_line_errors(const LatticeReading& reading, std::size_t num_lasers);

/// Estimates how far the points of windows are beside their lines on average.
///
/// Rounding coordinates to whole millimetres leaves errors with a mean of 0. Moving points along
/// rays from the scanner's centre does not: the lasers are beside the centre, so that all moved
/// points of a window leave their lines by about the same distance.
/// @param voxel_of_point  (N,) number of each point's voxel; -1: the point has no ring.
/// @param means           mean_line_errors(): errors are those beyond the mean of their laser.
/// @return  (voxels.size(),) mean error of the window around each voxel, in standard deviations. If
///          the spread of all windows is larger than rounding explains, this spread is the unit.
///          All values are 0 if few windows hold enough points.
std::vector<float> drift_deviations(const PointsView& points, const LatticeReading& reading,
                                    const ScanLattice& lattice, const RangeVoxels& voxels,
                                    const std::vector<std::int32_t>& voxel_of_point,
                                    const std::vector<double>& means);

}  // namespace manip3d
