#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/forge/forgery.hpp"

namespace manip3d {

/// The directions that a spinning scanner measures: ring k meets the points z = slope_k rho +
/// offset_k, rho = hypot(x, y), in azimuth steps. An ideal terrestrial scanner is the case of equal
/// offsets. Coordinates are the scanner's own.
struct ScanLattice {
  struct Ring {
    double slope = 0.0;   ///< dz / drho.
    double offset = 0.0;  ///< Metres: the height of the laser above the origin.
  };
  std::vector<Ring> rings;
  double azimuth_step = 0.0;   ///< Radians, 1e-4 to 1; 0: unknown.
  double azimuth_phase = 0.0;  ///< Radians: some azimuth that is measured.
};

/// @throws InputError  no rings, a number that is not finite, a negative azimuth step.
void check_lattice(const ScanLattice& lattice);

/// Which ring passes nearest to (rho, z), measured in height; ties go to the lower index.
std::int32_t nearest_ring(const ScanLattice& lattice, double rho, double z);

enum class Snapping : std::uint8_t {
  kHeight,  ///< z <- slope rho + offset.
  kRay,     ///< The point moves on the ray from the origin until it meets a ring's line.
};

struct SnapOptions {
  Snapping along = Snapping::kHeight;
  bool azimuth = true;    ///< Turn to the nearest azimuth step as well, where it is known.
  double max_move = 1.0;  ///< Metres: a point whose line is farther along the ray moves in height.
};

/// Takes the given rows (what was pasted, say) onto the lattice of the scanner.
/// @throws InputError  what check_points and check_lattice refuse; a row that is none.
Forgery snap_to_lattice(const PointsView& scene, std::vector<std::int32_t> rows,
                        const ScanLattice& lattice, const SnapOptions& options = {},
                        int num_threads = 0);

}  // namespace manip3d
