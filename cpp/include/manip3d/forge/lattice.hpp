#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/forge/forgery.hpp"
#include "manip3d/geometry/lattice.hpp"

namespace manip3d {

enum class Snapping : std::uint8_t {
  kHeight,  ///< Change the height only: z = slope rho + offset.
  kRay,     ///< Move the point along the ray from the origin to the line of a ring.
};

struct SnapOptions {
  Snapping along = Snapping::kHeight;
  bool azimuth = true;  ///< Rotate to the nearest azimuth step as well, if the lattice has one.
  /// Metres: if the move along the ray would be longer, the height is changed instead.
  double max_move = 1.0;
};

/// Checks a lattice with check_lattice(), and for what attacks need in addition: an azimuth step of
/// 0, or of 1e-4 to 1 radian (a turn would have too many columns with a finer one, and hardly any
/// with a coarser one), and the same azimuth for all rings, up to 1000 radians.
/// @throws InputError  the lattice fails these checks.
void check_azimuths(const ScanLattice& lattice);

/// Moves the given rows, for example of a pasted object, onto the lattice of the scanner. Lateral
/// offsets of rings are ignored.
/// @throws InputError  the points or the lattice fail check_points or check_azimuths; a row out of
///                     range.
Forgery snap_to_lattice(const PointsView& scene, std::vector<std::int32_t> rows,
                        const ScanLattice& lattice, const SnapOptions& options = {},
                        int num_threads = 0, const Progress& progress = {});

}  // namespace manip3d
