#pragma once

#include <cstdint>
#include <vector>

#include "authenticate/ground_plane.hpp"
#include "authenticate/ring_image.hpp"
#include "manip3d/authenticate/lattice.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The steps of the encoder at which the scanner fired, and their order.
struct FiringSchedule {
  std::vector<std::int32_t> order;  ///< (steps,): number of the firing at a count; -1: no firing.
  /// (steps,): 1 if enough lasers have returns nearby to decide.
  std::vector<std::uint8_t> judged;
  int firings = 0;
};

/// Finds the steps with returns of most of the lasers that have returns at neighbouring steps.
FiringSchedule find_firings(const LatticeReading& reading, const ScanLattice& lattice);

enum class Answer : std::uint8_t {
  kNone,
  kGround,  ///< The return is near the ground plane.
  /// The return is off the plane, and not nearer than 0.7 of the distance at which the ray meets
  /// it.
  kBeyond,
  kNearer,
};

/// Returns of one turn: a row per laser, a column per firing. Columns are counted from straight
/// ahead, so that equal columns of different lasers have about the same azimuth, although each
/// laser looks in another direction when it fires.
struct Answers {
  RingImage<Answer> kind;
  RingImage<std::int32_t> point;  ///< -1: none.
};

Answers sort_answers(const PointsView& points, const LatticeReading& reading,
                     const ScanLattice& lattice, const FiringSchedule& schedule,
                     const GroundPlane& ground);

/// A set of adjacent firings without an expected return: they point at ground within range, the
/// ground just below them has returns, so have the firings on both sides with sufficient range, and
/// nothing nearer is seen there. Deleting the points of an object leaves such a hole.
struct Void {
  struct Cell {
    int ring;
    double azimuth;  ///< Radians, in [0, 2 pi).
  };
  std::vector<Cell> cells;
  double distance;  ///< Metres: median horizontal distance of the ground below.
  /// Weight of each cell: the share of the void that is not explained by a hole nearby in another
  /// turn. A dark car causes such holes, which move with it.
  double weight = 1.0;
};

struct VoidOptions {
  double min_ground_range = 8.0;
  double max_ground_range = 80.0;
  /// Least number of returns among the 8 firings on each side in the ring.
  int answered_beside = 7;
  /// The previous and following turn, or one of them. A firing counts as lost only if it and its
  /// neighbours have returns in all given turns. With two turns this alone proves a hole, which
  /// then need not begin above ground.
  std::vector<const Answers*> other_turns;
  Progress progress;  ///< May cancel the search.
};

std::vector<Void> find_voids(const PointsView& points, const Answers& answers,
                             const ScanLattice& lattice, const GroundPlane& ground,
                             const VoidOptions& options);

}  // namespace manip3d
