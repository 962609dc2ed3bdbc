#include "manip3d/geometry/lattice.hpp"

#include <cmath>
#include <limits>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {

double ScanLattice::Ring::uncertainty(double rho) const {
  return 4.0 * slope_error * std::abs(rho - center);
}

void check_lattice(const ScanLattice& lattice) {
  if (lattice.rings.empty()) throw InputError("lattice: expected rings, got none");
  for (const ScanLattice::Ring& ring : lattice.rings) {
    for (const double value : {ring.slope, ring.offset, ring.lateral, ring.azimuth,
                               ring.range_phase, ring.center, ring.slope_error}) {
      if (!std::isfinite(value)) {
        throw InputError("lattice: expected finite numbers, got " + number_text(value) +
                         " in ring " + std::to_string(&ring - lattice.rings.data()));
      }
    }
  }
}

std::int32_t nearest_ring(const ScanLattice& lattice, double rho, double z) {
  std::int32_t best = 0;
  double distance = std::numeric_limits<double>::infinity();
  for (std::int32_t k = 0; k < lattice.num_rings(); ++k) {
    const double d = std::abs(z - (lattice.rings[k].slope * rho + lattice.rings[k].offset));
    if (d < distance) {
      distance = d;
      best = k;
    }
  }
  return best;
}

}  // namespace manip3d
