#pragma once

#include <cstdint>
#include <vector>

namespace manip3d {

/// The lattice on which a spinning scanner measures: one line z(rho) per laser, an encoder that
/// counts steps of azimuth, and ranges and coordinates that are multiples of a unit. Coordinates
/// are in the scanner's own frame, metres, with z along the axis of rotation. A step of 0 means
/// that there is no such step or that it is unknown.
///
/// A ring is the set of points that one laser measures in a turn. A laser at horizontal angle a
/// measures points (x, y, z) with x cos a + y sin a = sqrt(rho^2 - lateral^2), y cos a - x sin a =
/// lateral, z = slope rho + offset, where rho = hypot(x, y) and a = azimuth + k * azimuth_step for
/// the encoder's count k. Its range is range_phase plus a multiple of range_step. An ideal
/// terrestrial scanner has offsets of 0.
struct ScanLattice {
  /// One laser.
  struct Ring {
    double slope = 0.0;        ///< dz / drho of its line.
    double offset = 0.0;       ///< Metres: height of the laser above the origin.
    double lateral = 0.0;      ///< Metres to the left of the axis.
    double azimuth = 0.0;      ///< Radians at count 0.
    double range_phase = 0.0;  ///< Metres in [0, range_step).
    double center = 0.0;       ///< Metres: mean rho of the points to which the line was fitted.
    double slope_error = 0.0;  ///< Standard error of the slope; 0: exact.

    /// Height of a point at (rho, z) above the line, metres.
    [[nodiscard]] double height_above(double rho, double z) const {
      return z - slope * rho - offset;
    }
    /// Uncertainty of the line at this distance, without rounding, metres: four standard
    /// deviations.
    [[nodiscard]] double uncertainty(double rho) const;
  };
  std::vector<Ring> rings;       ///< The highest laser first, so slopes descend.
  int steps = 0;                 ///< Encoder counts per revolution.
  double azimuth_step = 0.0;     ///< Radians per count.
  double range_step = 0.0;       ///< Metres.
  double coordinate_step = 0.0;  ///< Metres; coordinates are multiples of it.

  /// The number of lasers.
  [[nodiscard]] int num_rings() const { return static_cast<int>(rings.size()); }
};

/// @throws InputError  no rings; a number that is not finite.
void check_lattice(const ScanLattice& lattice);

/// The ring nearest to (rho, z), measured in height; ties go to the lower index.
std::int32_t nearest_ring(const ScanLattice& lattice, double rho, double z);

}  // namespace manip3d
