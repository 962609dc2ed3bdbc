#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"

/// @file
/// Detector III: has this LiDAR scan been edited, told from the scan alone?
namespace manip3d {

/// Ways in which a scan can contradict its known lattice. All but the last
/// four are said of single points.
enum class Evidence : std::uint8_t {
  kGrid,       ///< Coordinates that are not whole numbers of the coordinate step.
  kLine,       ///< Points beside the line of every laser.
  kStep,       ///< Points between two steps of the encoder.
  kFiring,     ///< Points at a step at which the scanner did not fire.
  kDuplicate,  ///< Two returns of one firing of one laser.
  kOrder,      ///< Points at the wrong place in the file.
  kPlace,      ///< Points that are not roundings of a place where their laser can have measured.
  kRange,      ///< Windows whose ranges are not whole numbers of the range step.
  kDrift,      ///< Windows whose points lie beside their lines on average, by less than rounding.
  kVoid,       ///< Firings that got no return although they went to the ground.
  kTime,       ///< Firings that got no return and were answered in the turns beside this one.
};
inline constexpr int kNumEvidence = 11;

struct GenericOptions {
  double tolerance = 0.002;  ///< Metres from line and step; rounding to 1 mm leaves 0.0008.
  /// A kind of evidence is dropped where a larger share of all points contradicts the lattice.
  double dropped_share = 0.2;
  /// Share of clean points more than a quarter of the range step off, at most: KITTI's frames have
  /// 0.06, of points nearer than 5 m 0.09.
  double range_incoherence = 0.12;
  /// Metres along the arc by which points may have been moved, besides rounding to 1 mm. Where that
  /// and the rounding are more than half a step of the encoder, points are of no firing; 0: none
  /// were moved, and the nearest step is believed.
  double azimuth_error = 0.0;
  double min_ground_range = 8.0;   ///< Metres; nearer, the vehicle hides the ground.
  double max_ground_range = 50.0;  ///< Metres; farther, grazing rays get lost in masses.
  int num_threads = 0;
};

/// Why a kind of evidence was not used.
enum class Dropped : std::uint8_t {
  kNo,
  kUnknown,       ///< The lattice says nothing about it.
  kContradicted,  ///< Too large a share of the whole frame contradicts it: it was processed.
  kDepends,       ///< It depends on evidence that was dropped.
  kNoGround,      ///< No ground plane was found.
  kNoPrevious,    ///< No earlier or later frame on the same lattice was given.
};

struct EvidenceReport {
  Dropped dropped = Dropped::kNo;
  double share = 0.0;     ///< Share of the points (ranges: excess of those a quarter step off).
  double strength = 0.0;  ///< Strength of the strongest region.
};

/// A connected set of cells with evidence.
struct SuspectRegion {
  std::array<double, kNumEvidence>
      strength{};  ///< Points; kRange: exponent; kDrift: deviations; kVoid, kTime: firings.
  Eigen::Vector3d lower = Eigen::Vector3d::Zero();  ///< Metres: axis-parallel box of the suspected
  Eigen::Vector3d upper = Eigen::Vector3d::Zero();  ///< points, or where removed ones stood.
};

inline constexpr int kCellColumns = 500;  ///< Cells of the map around the horizon, 0.72 degrees.
inline constexpr int kCellRings = 2;      ///< Lasers per row of cells.

struct GenericResult {
  std::array<EvidenceReport, kNumEvidence> evidence;
  std::vector<std::uint16_t> flags;  ///< (N,): bit e is set where Evidence(e) was found.
  std::vector<std::uint16_t> cells;  ///< (rows x kCellColumns): pieces of evidence in each.
  std::vector<std::int32_t> region_of_point;  ///< (N,): of a point with flags; else -1.
  std::vector<SuspectRegion> regions;         ///< In the order of their first cells.
  int num_turns = 0;  ///< Turns before and after this one by which kTime was judged: 0 to 2.
  /// Pairs of a laser and a step of the encoder that had a return; without an encoder, points.
  std::int64_t num_directions = 0;
};

/// Looks for edits in one frame of a scanner whose lattice is known.
///
/// A kind of evidence that a large share of the whole frame contradicts is not evidence of an edit:
/// somebody processed the frame as a whole (motion compensation, another unit), or it is of another
/// scanner. It is dropped, with all that stands on it.
/// @param previous, following  the frames a turn earlier and later, or no points.
/// @throws InputError  what check_points and check_lattice refuse; an option out of range.
GenericResult generic_consistency(const PointsView& points, const ScanLattice& lattice,
                                  const GenericOptions& options = {},
                                  const PointsView& previous = {}, const PointsView& following = {},
                                  const Progress& progress = {});

/// Overload for points whose places on this lattice are known from read_lattice.
/// @throws InputError  what check_reading refuses, too.
GenericResult generic_consistency(const PointsView& points, const ScanLattice& lattice,
                                  LatticeReading reading, const GenericOptions& options,
                                  const PointsView& previous, const PointsView& following,
                                  const Progress& progress = {});

}  // namespace manip3d
