#pragma once

#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct SparseOptions {
  int neighbours = 4;     ///< Distances are to so many nearest other points; 1 to 8.
  double nearest = 0.24;  ///< Metres; shorter distances are left out.
  double angle = 0.012;   ///< Radians: so are those shorter than this times the range.
  double farthest = 2.0;  ///< Metres; larger distances are given as this one.
  int every = 2;          ///< One in so many of the points without neighbours beside them in the
                          ///< file is searched for.
};

/// Distances of points of a scan from their nearest other points, the first to the last of
/// `neighbours`, where those are no nearer than `nearest` and than `angle` times the range from
/// (0, 0, 0); exact up to `farthest`. For each neighbour, they are in the order of the points.
///
/// Most points of a scan have their neighbours beside them in the file; only those that do not are
/// searched for in cells, and of these one in `every`.
/// @throws InputError  what check_points refuses; coordinates of a thousand kilometres and more;
///                     an option out of range.
std::vector<std::vector<float>> sparse_distances(const PointsView& view,
                                                 const SparseOptions& options = {},
                                                 const Progress& progress = {});

}  // namespace manip3d
