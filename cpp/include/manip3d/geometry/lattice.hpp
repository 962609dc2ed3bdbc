#pragma once

#include <cstdint>
#include <vector>

namespace manip3d {

/// The lattice on which a spinning scanner measures: one line z(rho) per laser, an encoder that
/// counts steps of azimuth, ranges and coordinates that are whole numbers of a unit. Coordinates
/// are the scanner's own, metres, with z along the axis of rotation. A step of 0 says that the
/// scanner has none or that it is unknown.
///
/// A ring is what one laser sees in a turn. A laser at horizontal angle a sees the points (x, y, z)
/// with x cos a + y sin a = sqrt(rho^2 - lateral^2), y cos a - x sin a = lateral, z = slope rho +
/// offset, where rho = hypot(x, y) and a = azimuth + k * azimuth_step for the encoder's count k;
/// its range is a whole number of range_step above range_phase. An ideal terrestrial scanner is the
/// case of offsets of 0.
struct ScanLattice {
  /// One laser.
  struct Ring {
    double slope = 0.0;        ///< dz / drho of its line.
    double offset = 0.0;       ///< Metres: the height of the laser above the origin.
    double lateral = 0.0;      ///< Metres left of the axis.
    double azimuth = 0.0;      ///< Radians at count 0.
    double range_phase = 0.0;  ///< Metres in [0, range_step).
    double center = 0.0;       ///< Metres: mean rho of the points the line was fitted to.
    double slope_error = 0.0;  ///< Standard error of the slope; 0: exact.

    /// Metres of a point at (rho, z) above the line.
    [[nodiscard]] double height_above(double rho, double z) const {
      return z - slope * rho - offset;
    }
    /// Metres by which the line may be off at a distance, beyond rounding: 4 deviations.
    [[nodiscard]] double uncertainty(double rho) const;
  };
  std::vector<Ring> rings;       ///< The highest laser first: slopes descend.
  int steps = 0;                 ///< Counts of the encoder per revolution.
  double azimuth_step = 0.0;     ///< Radians from count to count.
  double range_step = 0.0;       ///< Metres.
  double coordinate_step = 0.0;  ///< Metres; coordinates are whole numbers of it.

  /// The number of lasers.
  [[nodiscard]] int num_rings() const { return static_cast<int>(rings.size()); }
};

/// @throws InputError  no rings, a number that is not finite.
void check_lattice(const ScanLattice& lattice);

/// Which ring passes nearest to (rho, z), measured in height; ties go to the lower index.
std::int32_t nearest_ring(const ScanLattice& lattice, double rho, double z);

}  // namespace manip3d
