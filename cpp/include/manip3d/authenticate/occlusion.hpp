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
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< The scanner's.
  ScanGrid grid;                ///< Cells of the image; see estimate_scan_grid.
  double min_gap = 0.1;         ///< Metres between nearest and farthest point of a cell that count.
  bool accumulate = false;      ///< The gap is summed over the points in order, as printed.
  std::int64_t min_cells = 40;  ///< A_th in cells; smaller components are not reported.
  double min_area = 0.01;       ///< A_th in square metres at the component's own range.
  /// Metres; components farther away are not reported.
  double max_range = std::numeric_limits<double>::infinity();
  int num_threads = 0;  ///< 0: all cores.
};

/// Cells in which something is seen behind something else, grown together.
struct OcclusionComponent {
  std::int64_t cells = 0;
  double solid_angle = 0.0;  ///< Steradians.
  double range = 0.0;        ///< Metres: median of its cells' nearest points.
  double area = 0.0;         ///< Square metres: solid angle times squared range.
  std::int64_t first_row = 0, last_row = 0;
  std::int64_t first_column = 0, last_column = 0;  ///< first > last: it goes round the back.
  OrientedBox box;                                 ///< Around its suspected points.
};

struct OcclusionResult {
  std::int64_t rows = 0, columns = 0;  ///< Shape of the mask.
  std::int64_t first_row = 0;          ///< First row of the mask, in rows of the grid.
  std::vector<std::uint8_t> mask;      ///< After closing and median; 1 = marked.
  std::vector<std::uint8_t> raw_mask;  ///< Before.
  std::int64_t occupied_cells = 0;
  std::int64_t multiple_cells = 0;                ///< Cells whose gap counts.
  std::vector<OcclusionComponent> components;     ///< Above A_th, the largest area first.
  std::vector<std::int32_t> suspected;            ///< Rows of points in front, in those; ascending.
  std::vector<std::int32_t> suspected_component;  ///< Component of each.
};

/// IsOcclusionConsistent (dissertation, algorithm II): where a direction holds points at more than
/// one distance, something was put in front of what the scanner saw.
///
/// Equirectangular image of the nearest and farthest range; the mask of gaps above `min_gap`;
/// closing 3x3, median 3x3, components of 8 neighbours; azimuth goes round. The same bytes for any
/// number of threads (`accumulate` uses one).
/// @throws InputError  what check_points refuses; an option out of range; more than 2^28 cells.
OcclusionResult occlusion_consistency(const PointsView& view, const OcclusionOptions& options,
                                      const Progress& progress = {});

}  // namespace manip3d
