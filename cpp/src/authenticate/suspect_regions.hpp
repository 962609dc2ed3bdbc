#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "authenticate/ring_image.hpp"
#include "authenticate/void_search.hpp"
#include "manip3d/authenticate/generic.hpp"

namespace manip3d {

constexpr std::size_t index_of(Evidence evidence) { return static_cast<std::size_t>(evidence); }

/// Amount of each kind of evidence, in the units of SuspectRegion::strength.
using Strength = std::array<double, kNumEvidence>;
/// Evidence by row of kCellRings lasers and by column of the horizon.
using EvidenceCells = RingImage<Strength>;

constexpr int cell_row(std::int32_t ring) { return ring / kCellRings; }

/// @param azimuth  Radians, in [0, 2 pi].
inline int cell_column(double azimuth) { return azimuth_column(azimuth, kCellColumns); }

/// Joins touching cells with evidence to regions with boxes and points. Sets all of `result` except
/// shares and reasons for dropping. Window flags (kRange, kDrift) are removed from points of
/// regions that also have evidence from single points.
void gather_regions(const PointsView& points, const ScanLattice& lattice,
                    const LatticeReading& reading, const EvidenceCells& cells,
                    const std::vector<Void>& voids, GenericResult& result);

}  // namespace manip3d
