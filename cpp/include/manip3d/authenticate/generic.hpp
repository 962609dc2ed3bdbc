#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"

/// @file
/// Detector III: decides from one LiDAR scan alone whether it was edited.
namespace manip3d {

/// Ways in which a scan can contradict its known lattice. The last four are about windows or
/// firings, the others about single points.
enum class Evidence : std::uint8_t {
  kGrid,       ///< Coordinates that are not whole numbers of the coordinate step.
  kLine,       ///< Points that are not on the line of any laser.
  kStep,       ///< Points between two steps of the encoder.
  kFiring,     ///< Points at a step at which the scanner did not fire.
  kDuplicate,  ///< Two returns of one firing of one laser.
  kOrder,      ///< Points at the wrong place in the file.
  kPlace,      ///< Points that are not roundings of a place where their laser can have measured.
  kRange,      ///< Windows whose ranges are not whole numbers of the range step.
  /// Windows whose points are beside their lines on average, by less than the rounding step.
  kDrift,
  kVoid,  ///< Firings without a return, although their rays meet the ground.
  kTime,  ///< Firings without a return that had one in the neighbouring turns.
};
inline constexpr int kNumEvidence = 11;

struct GenericOptions {
  /// Metres: farther points are off their line or step; rounding to 1 mm leaves 0.0008.
  double tolerance = 0.002;
  /// A kind of evidence is dropped if a larger share of all points contradicts the lattice.
  double dropped_share = 0.2;
  /// Upper limit of the share of clean points whose range is more than a quarter of the range step
  /// off. KITTI's frames have 0.06, and 0.09 among points nearer than 5 m.
  double range_incoherence = 0.12;
  /// Metres along the arc by which points may have been moved, besides rounding to 1 mm. If both
  /// together are more than half a step of the encoder at a point, its firing is unknown. 0: no
  /// points were moved, and the nearest step is taken.
  double azimuth_error = 0.0;
  double min_ground_range = 8.0;   ///< Metres: nearer ground is hidden by the vehicle.
  double max_ground_range = 50.0;  ///< Metres: farther, many grazing rays have no return.
  int num_threads = 0;
};

/// Reason why a kind of evidence was not used.
enum class Dropped : std::uint8_t {
  kNo,
  kUnknown,  ///< The lattice does not have the property.
  /// Too large a share of the frame contradicts the lattice: all of it was processed.
  kContradicted,
  kDepends,     ///< It depends on evidence that was dropped.
  kNoGround,    ///< No ground plane was found.
  kNoPrevious,  ///< No earlier or later frame on the same lattice was given.
};

struct EvidenceReport {
  Dropped dropped = Dropped::kNo;
  /// Share of the contradicting points (kRange: excess of the share of points a quarter step off).
  double share = 0.0;
  double strength = 0.0;  ///< Strength of the strongest region.
};

/// A connected set of cells with evidence.
struct SuspectRegion {
  /// Strength of each kind of evidence. Units: points; kRange: exponent; kDrift: standard
  /// deviations; kVoid, kTime: firings.
  std::array<double, kNumEvidence> strength{};
  /// Metres: lower corner of the axis-parallel box of the suspected points or of the places of
  /// removed ones.
  Eigen::Vector3d lower = Eigen::Vector3d::Zero();
  Eigen::Vector3d upper = Eigen::Vector3d::Zero();  ///< Metres: upper corner.
};

/// Cells of the map around the horizon, each 0.72 degrees wide.
inline constexpr int kCellColumns = 500;
inline constexpr int kCellRings = 2;  ///< Lasers per row of cells.

struct GenericResult {
  std::array<EvidenceReport, kNumEvidence> evidence;
  std::vector<std::uint16_t> flags;  ///< (N,): bit e is set if there is Evidence(e).
  std::vector<std::uint16_t> cells;  ///< (rows x kCellColumns): pieces of evidence in each cell.
  std::vector<std::int32_t> region_of_point;  ///< (N,): region of each flagged point; -1: no flags.
  std::vector<SuspectRegion> regions;         ///< Regions in the order of their first cells.
  int num_turns = 0;  ///< Number of neighbouring turns that kTime compared with: 0 to 2.
  /// Pairs of a laser and a step of the encoder with a return; without an encoder, points.
  std::int64_t num_directions = 0;
};

/// Detects edits in one frame of a scanner whose lattice is known.
///
/// A kind of evidence that a large share of the whole frame contradicts is not evidence of an edit:
/// the frame was processed as a whole (by motion compensation, or in another unit), or another
/// scanner measured it. This kind is dropped, together with all that depend on it.
/// @param previous, following  the previous and the next frame, or no points.
/// @throws InputError  the points or the lattice fail check_points or check_lattice; an option out
///                     of range.
GenericResult generic_consistency(const PointsView& points, const ScanLattice& lattice,
                                  const GenericOptions& options = {},
                                  const PointsView& previous = {}, const PointsView& following = {},
                                  const Progress& progress = {});

/// Overload for points that read_lattice has read on this lattice.
/// @throws InputError  also if the reading fails check_reading.
GenericResult generic_consistency(const PointsView& points, const ScanLattice& lattice,
                                  LatticeReading reading, const GenericOptions& options,
                                  const PointsView& previous, const PointsView& following,
                                  const Progress& progress = {});

}  // namespace manip3d
