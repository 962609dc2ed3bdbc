#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"
#include "manip3d/geometry/align_scans.hpp"

/// @file
/// Evidence that a frame hides what the turns before and after it saw. A frame is one turn of a
/// spinning scanner.
namespace manip3d {

enum class TurnEvidence : std::uint8_t {
  kLost,     ///< No return, where both turns had returns from one surface.
  kThrough,  ///< Returns from behind a surface that both turns saw.
  kBefore,   ///< Returns from a place that both turns saw through.
};
inline constexpr int kNumTurnEvidence = 3;

/// A connected set of directions with one kind of evidence.
struct TurnRegion {
  TurnEvidence kind = TurnEvidence::kLost;
  std::int64_t cells = 0;  ///< Number of directions.
  /// Directions above the ground in which both turns saw something at the same distance.
  std::int64_t agreed = 0;
  std::int64_t ground = 0;  ///< Directions in which the turns saw the ground.
  /// Nearby directions where a turn has this evidence and the frame has not: something moved away.
  std::int64_t moved = 0;
  /// Metres: median distance of what the turns saw in the region; kBefore: of the frame's returns.
  double distance = 0.0;
  /// Points of the previous turn in the region, in the frame's coordinates; kBefore: empty.
  Points stood;
  std::vector<std::int32_t> rows;  ///< Row numbers of the frame's points in the region.
};

struct TurnOptions {
  /// Metres: nearer places are not compared, because the vehicle hides them.
  double nearest = 4.5;
  /// Metres: farther places are not compared, because the lasers of two turns miss each other's
  /// spots.
  double farthest = 35.0;
  double height = 0.3;     ///< Metres above the ground plane: lower returns count as ground.
  double tolerance = 0.3;  ///< Metres between the places of one surface in two turns, added to ...
  double tolerance_share = 0.03;  ///< ... this share of the distance.
  /// True if no points were removed from the neighbouring turns. If false, kThrough and kBefore
  /// need returns of both turns in the direction and the eight around it, and returns of the frame
  /// outside the extent of a turn are not evidence that something moved away.
  bool whole_turns = true;
  int num_threads = 0;
};

struct TurnResult {
  ScanMotion previous, following;  ///< Motions from the turns' coordinates to the frame's.
  bool has_ground = false;
  bool is_steady = false;  ///< The scanner moved after the frame about as it did before it.
  /// Regions by kind, then in the order of their first directions.
  std::vector<TurnRegion> regions;
  /// Lattice readings of the points of both turns in the frame's coordinates; empty if the turns
  /// were not compared.
  std::array<LatticeReading, 2> seen;

  /// Could both turns be aligned, in agreement with each other, and was a ground plane found?
  [[nodiscard]] bool is_judged() const {
    return has_ground && is_steady && previous.is_found() && following.is_found();
  }
};

inline constexpr int kTurnColumns = 1080;  ///< Directions around the horizon, two firings in each.

/// Compares a frame with the turns before and after it.
///
/// Both turns are aligned with the frame. An object that both saw at one place stood still: the
/// frame must see it too, or something nearer that hides it. A place that both saw through must be
/// free in the frame, because no moving object is absent in both turns and present between them.
/// @throws InputError  the points fail check_points or the lattice fails the checks of
///                     read_lattice; an option out of range.
TurnResult compare_turns(const PointsView& points, const PointsView& previous,
                         const PointsView& following, const ScanLattice& lattice,
                         const TurnOptions& options = {}, const Progress& progress = {});

/// Overload for points that read_lattice has read on this lattice; only rings, azimuths and line
/// errors are used.
/// @throws InputError  also if the reading fails check_reading.
TurnResult compare_turns(const PointsView& points, const PointsView& previous,
                         const PointsView& following, const ScanLattice& lattice,
                         LatticeReading reading, const TurnOptions& options = {},
                         const Progress& progress = {});

}  // namespace manip3d
