#pragma once

#include <Eigen/Core>

#include "manip3d/geometry/lattice.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Places of points on a lattice: one entry per point.
struct LatticeReading {
  Indices ring;   ///< The nearest line; -1: the point is on the scanner's axis or at its centre.
  Indices count;  ///< The encoder's count in [0, steps); -1: no ring, or a lattice without steps.
  Eigen::VectorXf azimuth;      ///< Radians: atan2(y, x) in [0, 2 pi]; 2 pi if y is -0 and x > 0.
  Eigen::VectorXf line_error;   ///< Metres from the line, positive upwards.
  Eigen::VectorXf step_error;   ///< Metres from the middle of the step, along the arc.
  Eigen::VectorXf range_error;  ///< Metres from the nearest multiple of the range step.
};

/// Checks what read_lattice needs of a lattice: check_lattice, at most 1024 rings, slopes that
/// descend, azimuths within one turn, steps in range.
/// @throws InputError  the lattice fails a check.
void check_readable(const ScanLattice& lattice);

/// Assigns each point to a laser and a step, and measures its distance from both. It takes about 40
/// ns per point in the scanner's own order, and more in any other. The result has the same bits for
/// any number of threads.
/// @throws InputError  the points or the lattice fail check_points or check_readable.
LatticeReading read_lattice(const PointsView& points, const ScanLattice& lattice,
                            int num_threads = 0, const Progress& progress = {});

/// Checks that a reading fits points and lattice.
/// @throws InputError  the points or the lattice fail the checks of read_lattice; the reading is of
///                     another number of points, or of another lattice: a ring or a count out of
///                     range, an azimuth beyond one turn.
void check_reading(const LatticeReading& reading, const PointsView& points,
                   const ScanLattice& lattice);

}  // namespace manip3d
