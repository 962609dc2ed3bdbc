#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"
#include "manip3d/geometry/align_scans.hpp"

/// @file
/// Evidence that a frame hides what the turns before and after it saw.
namespace manip3d {

enum class TurnEvidence : std::uint8_t {
  kLost,     ///< No return where both turns had returns from a surface at one place.
  kThrough,  ///< Returns from behind the place where both turns saw one surface.
  kBefore,   ///< Returns from a place that both turns looked through.
};
inline constexpr int kNumTurnEvidence = 3;

/// A connected set of directions with one kind of evidence.
struct TurnRegion {
  TurnEvidence kind = TurnEvidence::kLost;
  std::int64_t cells = 0;   ///< Directions.
  std::int64_t agreed = 0;  ///< Directions above the ground in which both turns saw one place.
  std::int64_t ground = 0;  ///< Directions in which both turns saw the ground.
  std::int64_t moved = 0;   ///< Directions nearby with the opposite: something moved away.
  double distance = 0.0;    ///< Metres: median distance of what the turns saw there.
  Points stood;             ///< The points that they saw there, in the frame's coordinates.
  std::vector<std::int32_t> rows;  ///< Points of the frame in those directions.
};

struct TurnOptions {
  double nearest = 4.5;           ///< Metres: nearer, the vehicle hides and shadows the road.
  double farthest = 35.0;         ///< Metres: farther, lasers pass between what two turns saw.
  double height = 0.3;            ///< Metres above the ground plane: what is lower is ground.
  double tolerance = 0.3;         ///< Metres between the places of one surface in two turns ...
  double tolerance_share = 0.03;  ///< ... and this share of the distance.
  /// Whether the turns have all of their points. If not, only directions in whose surroundings they
  /// have returns throughout tell of places that they looked through, and returns of the frame
  /// beyond what a turn has left do not tell that something moved away.
  bool whole_turns = true;
  int num_threads = 0;
};

struct TurnResult {
  ScanMotion previous, following;  ///< Motions from the turns' coordinates to the frame's.
  bool has_ground = false;
  bool is_steady = false;           ///< The scanner went on after the frame as it did before.
  std::vector<TurnRegion> regions;  ///< By kind, then in the order of their first directions.
  /// The places of both turns' points, in the frame's coordinates, on the lattice; empty where
  /// they are not judged.
  std::array<LatticeReading, 2> seen;

  /// Whether both turns could be aligned, one like the other, and a ground plane was found.
  [[nodiscard]] bool is_judged() const {
    return has_ground && is_steady && previous.is_found() && following.is_found();
  }
};

inline constexpr int kTurnColumns = 1080;  ///< Directions around the horizon: two firings each.

/// Compare a frame with the turns before and after it, free space by free space. Both turns are
/// aligned with the frame; what both saw at one place stands still, and must be seen, or hidden by
/// something nearer. Nothing that moves leaves a place between two turns and is back in time.
/// @throws InputError  what check_points and read_lattice refuse; an option out of range.
TurnResult compare_turns(const PointsView& points, const PointsView& previous,
                         const PointsView& following, const ScanLattice& lattice,
                         const TurnOptions& options = {}, const Progress& progress = {});

/// Overload for points whose places on this lattice are known from read_lattice; only rings,
/// azimuths and line errors are used.
/// @throws InputError  what check_reading refuses, too.
TurnResult compare_turns(const PointsView& points, const PointsView& previous,
                         const PointsView& following, const ScanLattice& lattice,
                         LatticeReading reading, const TurnOptions& options = {},
                         const Progress& progress = {});

}  // namespace manip3d
