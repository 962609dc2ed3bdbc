#include "authenticate/suspect_regions.hpp"

#include <limits>

#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

using RegionOfCell = RingImage<std::int32_t>;  // -1: none

SuspectRegion region_of(const std::vector<RingCell>& component, const EvidenceCells& cells) {
  SuspectRegion found;
  found.lower.setConstant(std::numeric_limits<double>::infinity());
  found.upper = -found.lower;
  for (const auto& [row, column] : component) {
    const Strength& cell = cells(row, column);
    for (std::size_t e = 0; e < kNumEvidence; ++e) {
      double& strength = found.strength[e];
      const bool is_window = e == index_of(Evidence::kRange) || e == index_of(Evidence::kDrift);
      strength = is_window ? std::max(strength, cell[e]) : strength + cell[e];
    }
  }
  return found;
}

// Adds the regions to `result`, and the amount of evidence in each cell.
RegionOfCell join_cells(const EvidenceCells& cells, GenericResult& result) {
  RingImage<std::uint8_t> suspect(cells.rings(), cells.columns(), 0);
  for (int row = 0; row < cells.rings(); ++row) {
    for (int column = 0; column < cells.columns(); ++column) {
      double sum = 0.0;
      for (const double strength : cells(row, column)) sum += strength;
      suspect(row, column) = sum > 0.0 ? 1 : 0;
      result.cells.push_back(static_cast<std::uint16_t>(std::min(sum + 0.5, 65535.0)));
    }
  }
  RegionOfCell number_of(cells.rings(), cells.columns(), -1);
  for (const auto& component : connected_components(suspect)) {
    const auto number = static_cast<std::int32_t>(result.regions.size());
    result.regions.push_back(region_of(component, cells));
    for (const auto& [row, column] : component) number_of(row, column) = number;
  }
  return number_of;
}

std::int32_t region_at(const RegionOfCell& regions, const LatticeReading& reading, std::int32_t i) {
  return regions(cell_row(reading.ring(i)), cell_column(reading.azimuth(i)));
}

// Windows reach beyond forged points. If single points of a region are known to be forged, these
// locate the edit better, so that the flags of windows are removed.
void forget_windows_beside_points(const RegionOfCell& regions, const LatticeReading& reading,
                                  GenericResult& result) {
  constexpr auto kWindow = static_cast<std::uint16_t>(1U << index_of(Evidence::kRange) |
                                                      1U << index_of(Evidence::kDrift));
  for (std::int32_t i = 0; i < reading.ring.size(); ++i) {
    std::uint16_t& flags = result.flags[i];
    if ((flags & kWindow) == 0) continue;
    const Strength& strength = result.regions[region_at(regions, reading, i)].strength;
    const auto* windows = strength.data() + index_of(Evidence::kRange);
    if (std::any_of(strength.data(), windows, [](double s) { return s > 0.0; })) {
      flags &= static_cast<std::uint16_t>(~kWindow);
    }
  }
}

// The place of a removed object: on the ray of a lost firing, at the distance of the last returns
// below it. The object stood on the ground there, or little behind.
Eigen::Vector3d stood_at(const Void::Cell& cell, double distance, const ScanLattice& lattice) {
  const SinCos azimuth = sin_cos(cell.azimuth);
  return {distance * azimuth.cos, distance * azimuth.sin,
          lattice.rings[cell.ring].slope * distance + lattice.rings[cell.ring].offset};
}

void extend_box(SuspectRegion& region, const Eigen::Vector3d& point) {
  region.lower = region.lower.cwiseMin(point);
  region.upper = region.upper.cwiseMax(point);
}

void find_boxes(const PointsView& points, const ScanLattice& lattice, const LatticeReading& reading,
                const std::vector<Void>& voids, const RegionOfCell& regions,
                GenericResult& result) {
  for (std::int32_t i = 0; i < points.num_points(); ++i) {
    if (result.flags[i] == 0) continue;
    extend_box(result.regions[region_at(regions, reading, i)],
               points.points.row(i).transpose().cast<double>());
  }
  for (const Void& found : voids) {
    for (const Void::Cell& cell : found.cells) {
      extend_box(result.regions[regions(cell_row(cell.ring), cell_column(cell.azimuth))],
                 stood_at(cell, found.distance, lattice));
    }
  }
}

void name_regions_of_points(const RegionOfCell& regions, const LatticeReading& reading,
                            GenericResult& result) {
  result.region_of_point.assign(result.flags.size(), -1);
  for (std::int32_t i = 0; i < reading.ring.size(); ++i) {
    if (result.flags[i] != 0) result.region_of_point[i] = region_at(regions, reading, i);
  }
}

}  // namespace

void gather_regions(const PointsView& points, const ScanLattice& lattice,
                    const LatticeReading& reading, const EvidenceCells& cells,
                    const std::vector<Void>& voids, GenericResult& result) {
  const RegionOfCell regions = join_cells(cells, result);
  forget_windows_beside_points(regions, reading, result);
  find_boxes(points, lattice, reading, voids, regions, result);
  name_regions_of_points(regions, reading, result);
  for (const SuspectRegion& found : result.regions) {
    for (std::size_t e = 0; e < kNumEvidence; ++e) {
      double& strength = result.evidence[e].strength;
      strength = std::max(strength, found.strength[e]);
    }
  }
}

}  // namespace manip3d
