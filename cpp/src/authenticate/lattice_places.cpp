#include "authenticate/lattice_places.hpp"

#include <cmath>

#include "manip3d/geometry/angles.hpp"

namespace manip3d {

LatticePlaces::LatticePlaces(const ScanLattice& lattice) : range_step_(lattice.range_step) {
  for (const ScanLattice::Ring& ring : lattice.rings) {
    const double cos = 1.0 / std::sqrt(1.0 + ring.slope * ring.slope);
    const SinCos azimuth = sin_cos(ring.azimuth);
    beams_.push_back({ring, {cos, ring.slope * cos}, {azimuth.cos, azimuth.sin}});
  }
  counts_.reserve(static_cast<std::size_t>(lattice.steps));
  for (int count = 0; count < lattice.steps; ++count) {
    const SinCos turn = sin_cos(count * lattice.azimuth_step);
    counts_.push_back({turn.cos, turn.sin});
  }
}

double LatticePlaces::distance(const Eigen::Vector3d& point, std::int32_t ring,
                               std::int32_t count) const {
  const auto& [line, elevation, start] = beams_[static_cast<std::size_t>(ring)];
  const Direction& turn = counts_[static_cast<std::size_t>(count)];
  const double rho = std::sqrt(point.x() * point.x() + point.y() * point.y());
  const double reach = std::sqrt(rho * rho - line.lateral * line.lateral);

  // The range as in read_lattice(), and the nearest multiple of the range step. The point and its
  // place are so near to each other that the difference between distance from the axis and distance
  // from the foot of the beam is taken as constant.
  const double range = reach * elevation.cos + point.z() * elevation.sin;
  const double steps = std::floor((range - line.range_phase) / range_step_ + 0.5);
  const double printed = line.range_phase + steps * range_step_;
  const double aside = rho - reach;
  const double foot = line.slope * aside + line.offset;
  const double along = (printed - foot * elevation.sin) * elevation.cos;

  const double cos = start.cos * turn.cos - start.sin * turn.sin;
  const double sin = start.sin * turn.cos + start.cos * turn.sin;
  const Eigen::Vector3d place(along * cos - line.lateral * sin, along * sin + line.lateral * cos,
                              line.slope * along + foot);
  return (point - place).cwiseAbs().maxCoeff();
}

}  // namespace manip3d
