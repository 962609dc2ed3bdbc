#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "authenticate/ring_image.hpp"
#include "authenticate/void_search.hpp"
#include "geometry/constants.hpp"
#include "manip3d/authenticate/generic.hpp"

namespace manip3d {

constexpr std::size_t index_of(Evidence evidence) { return static_cast<std::size_t>(evidence); }

/// How much of each kind of evidence there is; the units are those of SuspectRegion.
using Strength = std::array<double, kNumEvidence>;
/// By kCellRings lasers and kCellColumns columns.
using EvidenceCells = RingImage<Strength>;

constexpr int cell_row(std::int32_t ring) { return ring / kCellRings; }

/// @param azimuth  radians, in [0, 2 pi].
inline int cell_column(double azimuth) {
  return std::min(static_cast<int>(azimuth * (kCellColumns / kFullTurn)), kCellColumns - 1);
}

/// Joins cells with evidence that touch each other to regions, with their boxes and points. Writes
/// all of `result` but its shares and what was dropped; reads its flags, which it takes from points
/// that windows alone suspect beside points that are known to be forged.
void gather_regions(const PointsView& points, const ScanLattice& lattice,
                    const LatticeReading& reading, const EvidenceCells& cells,
                    const std::vector<Void>& voids, GenericResult& result);

}  // namespace manip3d
