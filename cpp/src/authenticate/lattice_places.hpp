#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/lattice.hpp"

namespace manip3d {

/// The places at which a scanner can measure: multiples of the range step along the beams of its
/// lasers at the counts of its encoder. A file holds these places with each coordinate rounded to
/// the coordinate step, so that a clean point is at most half a step from its place along each
/// axis.
class LatticePlaces {
 public:
  /// @param lattice  It has an encoder and a range step.
  explicit LatticePlaces(const ScanLattice& lattice);

  /// Returns the largest coordinate difference, metres, between a point and the nearest place of
  /// one firing of a laser. The point must not be on the axis, as read_lattice() ensures for points
  /// with a ring.
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
  std::vector<Direction> counts_;  // turn of the encoder from count 0 to each count
  double range_step_;
};

}  // namespace manip3d
