#pragma once

#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct SparseOptions {
  int neighbours = 4;  ///< Number of nearest other points, 1 to 8, to which distances are measured.
  double nearest = 0.24;  ///< Metres; shorter distances are left out.
  double angle = 0.012;   ///< Radians; distances below this times the range are left out as well.
  double farthest = 2.0;  ///< Metres; larger distances are replaced by this.
  /// Only one in this many of the points without near neighbours beside them in the file is
  /// examined.
  int every = 2;
};

/// Find isolated points of a scan: distances of points from their nearest other points, the first
/// to the last of `neighbours`, where those are at least `nearest` and at least `angle` times the
/// range from (0, 0, 0). They are exact up to `farthest`. For each neighbour, distances are in the
/// order of the points.
///
/// Most points of a scan have their neighbours beside them in the file. Only points without such
/// neighbours are searched for in cells, and of these only one in `every`.
/// @throws InputError  as check_points; coordinates of at least a thousand kilometres; an option
///                     out of range.
std::vector<std::vector<float>> sparse_distances(const PointsView& view,
                                                 const SparseOptions& options = {},
                                                 const Progress& progress = {});

}  // namespace manip3d
