#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "authenticate/range_windows.hpp"
#include "manip3d/authenticate/lattice.hpp"

namespace manip3d {

/// Whether a point is so near to its laser's line that it counts for the mean of its window: what
/// is farther speaks for itself.
inline bool is_near_line(const LatticeReading& reading, std::int32_t point) {
  constexpr double kGate = 0.0012;  // metres
  return reading.ring(point) >= 0 && std::abs(reading.line_error(point)) < kGate;
}

/// How far the points of windows lie beside their lines on average.
///
/// Coordinates of whole millimetres leave an error that averages out; what was moved along rays
/// from the scanner's centre leaves the lines of lasers that are beside it, all points by the same.
/// @param voxel_of_point  (N,) number of each point's voxel; -1: the point was not read.
/// @return (voxels.size(),) deviations of the mean of the window around each voxel, in units of
/// their common spread where that is larger than rounding explains; 0 where few windows hold enough
/// points.
std::vector<float> drift_deviations(const PointsView& points, const LatticeReading& reading,
                                    const ScanLattice& lattice, const RangeVoxels& voxels,
                                    const std::vector<std::int32_t>& voxel_of_point);

}  // namespace manip3d
