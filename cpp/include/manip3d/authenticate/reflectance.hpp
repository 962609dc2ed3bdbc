#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"
#include "manip3d/geometry/align_scans.hpp"

/// @file
/// Evidence that the reflectance of a part of a frame was rewritten. A frame is one turn of a
/// spinning scanner.
namespace manip3d {

enum class ReflectanceEvidence : std::uint8_t {
  kEven,     ///< Neighbours along a ring have the same reflectance: no shot noise.
  kChanged,  ///< The turns before and after agree on a reflectance that the frame does not have.
};

/// A connected set of directions with one kind of evidence.
struct ReflectanceRegion {
  ReflectanceEvidence kind = ReflectanceEvidence::kEven;
  /// kEven: log likelihood ratio of a rewritten surface over a clean one. kChanged: sum of the
  /// points' distances from the scanner in metres, each weighed by how far its window exceeds the
  /// threshold. Values of different kinds cannot be compared.
  double strength = 0.0;
  std::vector<std::int32_t> rows;  ///< Points of the frame in those directions, ascending.
};

struct ReflectanceOptions {
  /// Metres from the scanner: nearer points are not compared, as they are of the vehicle itself.
  double nearest = 4.0;
  /// Metres from the scanner: farther points are not compared, as the spots that two turns see on a
  /// surface lie too far apart there.
  double farthest = 35.0;
  /// Metres: a point is compared with those of another turn that are nearer to it than this.
  double reach = 0.35;
  int num_threads = 0;  ///< 0: all cores.
};

/// A turn beside the frame, and the motion that takes it into the frame's coordinates.
struct ReflectanceTurn {
  const PointsView& points;
  ScanMotion motion;
  /// Lattice reading of the turn's points in the frame's coordinates, which compare_turns() returns
  /// as well. Null: it is computed.
  const LatticeReading* seen = nullptr;
};

/// Estimates how much brighter than the mean each laser measures the same surfaces: sums of the
/// median differences between neighbouring lasers of the frame.
/// @return  (rings,), of mean 0.
std::vector<double> laser_gains(const PointsView& points, const LatticeReading& reading,
                                int num_rings);

/// Detects rewritten reflectances in one frame.
///
/// Reflectances are shares in [0, 1]. The smallest and largest value of the frame are taken as the
/// ends of the scale, where values are clipped; clipped values are not tested for evenness.
///
/// If both neighbouring turns are given, the reflectance I of a point is compared with the means P
/// and N of the points around it in the previous and in the next turn, all without the gains of
/// their lasers. With the same noise variance in all three turns, E = I - (P + N) / 2 has 3/2 of
/// this variance and D = P - N has twice of it. Motion and patterned surfaces raise both, an edit
/// raises E, or the mean of E over a window. The window must be evidence whichever pair of lasers
/// is left out, because a single laser may run along an edge. Each window is judged with and
/// without clipped returns, and the stronger evidence counts. Returns that are clipped at the same
/// end in all three turns are not compared.
/// @throws InputError  the points fail check_points or the lattice fails the checks of
///                     read_lattice; points have no reflectance, or one beyond [0, 1]; the reading
///                     is of other points; an option is out of range.
std::vector<ReflectanceRegion> compare_reflectance(const PointsView& points,
                                                   const ScanLattice& lattice,
                                                   const ReflectanceTurn* previous,
                                                   const ReflectanceTurn* following,
                                                   const ReflectanceOptions& options = {},
                                                   const Progress& progress = {});

/// Overload for points whose places on this lattice are known from read_lattice; only rings and
/// azimuths are used.
/// @throws InputError  also if the reading fails check_reading.
std::vector<ReflectanceRegion> compare_reflectance(
    const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
    const ReflectanceTurn* previous, const ReflectanceTurn* following,
    const ReflectanceOptions& options, const Progress& progress = {});

}  // namespace manip3d
