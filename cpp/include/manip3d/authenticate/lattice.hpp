#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// The lattice on which a spinning scanner measures: one line z(rho) per laser, an encoder that
/// counts steps of azimuth, ranges and coordinates that are whole numbers of a unit.
namespace manip3d {

/// The lattice of one scanner. Lasers are rows, from the highest to the lowest.
///
/// A laser at horizontal angle a sees the points (x, y, z) with x cos a + y sin a = sqrt(rho^2 -
/// lateral^2), y cos a - x sin a = lateral, z = slope rho + offset, where rho = hypot(x, y) and
/// a = azimuth + k * azimuth_step for the encoder's count k; its range is a whole number of
/// range_step above range_phase. A step of 0 says that the scanner has none or that it is unknown.
struct RingLattice {
  Eigen::VectorXd slope;         ///< (R,) of the line, descending.
  Eigen::VectorXd offset;        ///< (R,) metres.
  Eigen::VectorXd lateral;       ///< (R,) metres left of the axis.
  Eigen::VectorXd azimuth;       ///< (R,) radians at count 0.
  Eigen::VectorXd range_phase;   ///< (R,) metres in [0, range_step).
  Eigen::VectorXd center;        ///< (R,) metres: mean rho of the points the line was fitted to.
  Eigen::VectorXd slope_error;   ///< (R,) standard error of the slope; 0: exact.
  int steps = 0;                 ///< Counts of the encoder per revolution; 0: unknown.
  double range_step = 0.0;       ///< Metres; 0: unknown.
  double coordinate_step = 0.0;  ///< Metres; coordinates are whole numbers of it; 0: unknown.

  [[nodiscard]] int num_rings() const { return static_cast<int>(slope.size()); }
  /// Metres by which the line of a ring may be off at a distance, beyond rounding: 4 deviations.
  [[nodiscard]] double uncertainty(int ring, double rho) const;
  [[nodiscard]] double azimuth_step() const;  ///< Radians; 0 where `steps` is.
};

/// @throws InputError  no ring; columns of different lengths; numbers that are not finite; slopes
///                     that do not descend; a negative step.
void check_lattice(const RingLattice& lattice);

/// Where points lie on a lattice. One row per point.
struct LatticeReading {
  Indices ring;                 ///< The nearest line; -1: on the scanner's axis or at its centre.
  Indices count;                ///< The encoder's, in [0, steps); -1: no ring or no steps.
  Eigen::VectorXf azimuth;      ///< atan2(y, x) in [0, 2 pi): what files are ordered by.
  Eigen::VectorXf line_error;   ///< Metres from the line, upwards.
  Eigen::VectorXf step_error;   ///< Metres from the middle of the step, along the arc.
  Eigen::VectorXf range_error;  ///< Metres from the nearest range that the scanner can print.
};

/// Assigns each point to a laser and a step, and measures how far off it is. About 40 ns a point
/// in the scanner's own order, more in another. The same bits for any number of threads.
/// @throws InputError  what check_points and check_lattice refuse.
LatticeReading read_lattice(const PointsView& points, const RingLattice& lattice,
                            int num_threads = 0);

}  // namespace manip3d
