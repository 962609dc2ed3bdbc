#pragma once

#include <cstdint>
#include <vector>

#include "authenticate/ground_plane.hpp"
#include "authenticate/ring_image.hpp"
#include "manip3d/authenticate/lattice.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Steps of the encoder at which a scanner fired, and their order.
struct FiringSchedule {
  std::vector<std::int32_t> order;   ///< (steps,): number of the firing at a count; -1: none.
  std::vector<std::uint8_t> judged;  ///< (steps,): 1 where enough lasers answer nearby to tell.
  int firings = 0;
};

/// Steps at which most lasers that answered at the neighbouring steps have answered.
FiringSchedule find_firings(const LatticeReading& reading, const ScanLattice& lattice);

enum class Answer : std::uint8_t {
  kNone,
  kGround,  ///< On the ground plane, about.
  kBeyond,  ///< Not there, but hardly nearer than the ray meets it.
  kNearer,
};

/// Returns of the firings of one turn: a row per laser, a column per firing. Columns are
/// counted from straight ahead, so that those of different lasers lie above each other although
/// each laser looks another way when it fires.
struct Answers {
  RingImage<Answer> kind;
  RingImage<std::int32_t> point;  ///< -1: none.
};

Answers sort_answers(const PointsView& points, const LatticeReading& reading,
                     const ScanLattice& lattice, const FiringSchedule& schedule,
                     const GroundPlane& ground);

/// Adjacent firings without a return where one was expected: they point at ground within range,
/// the ground just below them answered, so did the firings on both sides that reach as far, and
/// nothing nearer is seen there. Deleting an object's points leaves such a hole.
struct Void {
  struct Cell {
    int ring;
    double azimuth;  ///< Radians, in [0, 2 pi).
  };
  std::vector<Cell> cells;
  double distance;  ///< Metres: median horizontal distance of the ground below.
  /// Weight of each cell: the share of the void that no hole of another turn nearby explains, which
  /// this turn does not have. A dark car makes such holes, which move with it.
  double weight = 1.0;
};

struct VoidOptions {
  double min_ground_range = 8.0;
  double max_ground_range = 80.0;
  int answered_beside = 7;  ///< Least answers among the eight firings to each side in the ring.
  /// Turns to compare with: the one before or after this one, or both. A firing counts as lost only
  /// if it and its neighbours were answered in all of them. With two of them that alone shows a
  /// hole, which then need not begin above ground.
  std::vector<const Answers*> beside;
  Progress progress;  ///< May cancel the search.
};

std::vector<Void> find_voids(const PointsView& points, const Answers& answers,
                             const ScanLattice& lattice, const GroundPlane& ground,
                             const VoidOptions& options);

}  // namespace manip3d
