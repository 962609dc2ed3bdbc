#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/forge/forgery.hpp"
#include "manip3d/geometry/lattice.hpp"

namespace manip3d {

enum class Snapping : std::uint8_t {
  kHeight,  ///< z <- slope rho + offset.
  kRay,     ///< The point moves on the ray from the origin until it meets a ring's line.
};

struct SnapOptions {
  Snapping along = Snapping::kHeight;
  bool azimuth = true;    ///< Turn to the nearest azimuth step as well, where it is known.
  double max_move = 1.0;  ///< Metres: a point whose line is farther along the ray moves in height.
};

/// check_lattice, and what attacks need: an azimuth step of 0 or 1e-4 to 1 radian (a finer one
/// would give a turn columns without end, a coarser one none), one azimuth of all rings, up to 1000
/// radians.
/// @throws InputError  no such lattice.
void check_azimuths(const ScanLattice& lattice);

/// Takes the given rows (what was pasted, say) onto the lattice of the scanner; rings without a
/// lateral offset.
/// @throws InputError  what check_points and check_azimuths refuse; a row out of range.
Forgery snap_to_lattice(const PointsView& scene, std::vector<std::int32_t> rows,
                        const ScanLattice& lattice, const SnapOptions& options = {},
                        int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
