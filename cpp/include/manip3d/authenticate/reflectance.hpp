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
inline constexpr int kNumReflectanceEvidence = 2;

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
  /// The reading of its points in the frame's coordinates on the lattice; compare_turns() has
  /// this reading. Null: it is made.
  const LatticeReading* seen = nullptr;
};

/// By how much lasers are brighter than one another on the same surfaces, from the frame itself:
/// the sum of the median differences of neighbouring lasers. (rings,), of mean 0.
std::vector<double> laser_gains(const PointsView& points, const LatticeReading& reading,
                                int num_rings);

/// Looks for rewritten reflectances in one frame.
///
/// Reflectances are shares in [0, 1]; the frame's smallest and largest value are taken for the ends
/// of the scale, where it is clipped; evenness is not looked for there. With both neighbours, the
/// reflectance I of a point is compared with P and N, those of the points around it a turn earlier
/// and later, less the gains of their lasers. If all three have the same noise, E = I - (P + N) / 2
/// has 3/2 of its variance and D = P - N twice; what moves or is patterned raises both, an edit
/// raises E, or the mean of E over a window. It must do so whichever pair of lasers is left out of
/// a window: a single one may run along an edge. Returns at an end of the scale are compared beside
/// the others, and left out: whichever shows more counts. Those at the same end in all three turns
/// say nothing.
/// @throws InputError  what check_points and read_lattice refuse; points without a reflectance, or
///                     with one beyond [0, 1]; a reading of other points; an option out of range.
std::vector<ReflectanceRegion> compare_reflectance(const PointsView& points,
                                                   const ScanLattice& lattice,
                                                   const ReflectanceTurn* previous,
                                                   const ReflectanceTurn* following,
                                                   const ReflectanceOptions& options = {},
                                                   const Progress& progress = {});

/// Overload for points whose places on this lattice are known from read_lattice; only rings and
/// azimuths are used.
/// @throws InputError  what check_reading refuses, too.
std::vector<ReflectanceRegion> compare_reflectance(
    const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
    const ReflectanceTurn* previous, const ReflectanceTurn* following,
    const ReflectanceOptions& options, const Progress& progress = {});

}  // namespace manip3d
