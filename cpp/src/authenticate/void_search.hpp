#pragma once

#include <cstdint>
#include <vector>

#include "authenticate/ground_plane.hpp"
#include "manip3d/authenticate/lattice.hpp"

namespace manip3d {

/// Steps of the encoder at which a scanner fired, and their order.
struct FiringSchedule {
  std::vector<std::int32_t> order;  ///< (steps,): number of the firing at a count; -1: none.
  int firings = 0;
};

/// Steps at which most lasers that answered at the neighbouring steps have answered.
FiringSchedule find_firings(const LatticeReading& reading, const RingLattice& lattice);

/// A set of firings side by side, directly above ground that answered, which went to the ground
/// themselves and got no return, although nothing nearer is seen there.
struct Void {
  struct Cell {
    int ring;
    double azimuth;  ///< Radians, in [0, 2 pi).
  };
  std::vector<Cell> cells;
  double distance;  ///< Metres: median horizontal distance of the ground below.
};

struct VoidOptions {
  double min_ground_range = 8.0;
  double max_ground_range = 40.0;
};

std::vector<Void> find_voids(const PointsView& points, const LatticeReading& reading,
                             const RingLattice& lattice, const FiringSchedule& schedule,
                             const GroundPlane& ground, const VoidOptions& options);

}  // namespace manip3d
