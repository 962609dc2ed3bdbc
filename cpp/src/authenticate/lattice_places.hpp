#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/lattice.hpp"

namespace manip3d {

/// The places at which a scanner can measure: the ends of its ranges along the beams of its lasers
/// at the counts of its encoder. A file holds them rounded to the coordinate step, each coordinate
/// by itself, so that a clean point is no more than half a step from its place along any axis.
class LatticePlaces {
 public:
  /// The lattice has an encoder and a range step.
  explicit LatticePlaces(const ScanLattice& lattice);

  /// Metres between a point and the nearest place of one firing of a laser, along the axis where
  /// they are farthest apart. The point lies off the laser's axis, as read_lattice asks.
  [[nodiscard]] double distance(const Eigen::Vector3d& point, std::int32_t ring,
                                std::int32_t count) const;

 private:
  struct Direction {
    double cos, sin;
  };

  struct Beam {
    ScanLattice::Ring line;
    Direction elevation;
    Direction azimuth;  // at count 0
  };

  std::vector<Beam> beams_;
  std::vector<Direction> counts_;  // turns from count 0
  double range_step_;
};

}  // namespace manip3d
