#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/geometry/scan_grid.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct OcclusionOptions {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< Position of the scanner, metres.
  ScanGrid grid;  ///< Cells of the image; see estimate_scan_grid.
  /// Metres between the nearest and the farthest point of a cell that make it a marked one.
  double min_gap = 0.1;
  /// True: sum the gaps between successive points of a cell, as the dissertation prints it.
  bool accumulate = false;
  std::int64_t min_cells = 40;  ///< Threshold A_th in cells; smaller components are not reported.
  double min_area = 0.01;       ///< Threshold A_th in square metres at the component's own range.
  /// Metres: components farther away are not reported.
  double max_range = std::numeric_limits<double>::infinity();
  int num_threads = 0;  ///< 0: all cores.
};

/// A connected set of cells in which something is seen behind something else.
struct OcclusionComponent {
  std::int64_t cells = 0;
  double solid_angle = 0.0;  ///< Steradians.
  double range = 0.0;        ///< Metres: median of the nearest points of its cells.
  double area = 0.0;         ///< Square metres: solid angle times squared range.
  std::int64_t first_row = 0, last_row = 0;
  /// Columns; first > last: the component crosses the seam of the image.
  std::int64_t first_column = 0, last_column = 0;
  OrientedBox box;  ///< Box around its suspected points.
};

struct OcclusionResult {
  std::int64_t rows = 0, columns = 0;  ///< Shape of the mask.
  std::int64_t first_row = 0;          ///< First row of the mask, in rows of the grid.
  std::vector<std::uint8_t> mask;      ///< The mask after closing and median; 1: marked.
  std::vector<std::uint8_t> raw_mask;  ///< The mask before closing and median.
  std::int64_t occupied_cells = 0;
  std::int64_t multiple_cells = 0;             ///< Cells whose gap exceeds min_gap.
  std::vector<OcclusionComponent> components;  ///< Components above A_th, the largest area first.
  /// Row numbers of the suspected points, ascending: those in front, in cells of a component.
  std::vector<std::int32_t> suspected;
  std::vector<std::int32_t> suspected_component;  ///< Component of each suspected point.
};

/// Detects points that were put in front of what the scanner saw: directions with points at more
/// than one distance. This is IsOcclusionConsistent (dissertation, algorithm II).
///
/// An equirectangular image holds the nearest and the farthest range of each cell. Its mask of gaps
/// above `min_gap` is closed (3x3) and filtered by a median (3x3); components have 8 neighbours and
/// continue across the seam of azimuth. The result has the same bytes for any number of threads
/// (`accumulate` uses one).
/// @throws InputError  the points fail check_points; an option out of range; more than 2^28 cells.
OcclusionResult occlusion_consistency(const PointsView& view, const OcclusionOptions& options,
                                      const Progress& progress = {});

}  // namespace manip3d
