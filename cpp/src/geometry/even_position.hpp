#pragma once

#include <Eigen/Core>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// A small piece of the surface that a scanner has seen.
struct SurfacePatch {
  Eigen::Vector3d place;   ///< Metres.
  Eigen::Vector3d normal;  ///< Unit length; either side.
  double density = 0.0;    ///< Points a square metre.
};

/// Patches around random points, each from the point's nearest neighbours. Neighbours on a line
/// make none.
std::vector<SurfacePatch> sample_patches(const Points& points, const Progress& progress);

/// The position of a scanner that turns about `axis` (0, 1, 2) from which each patch has the
/// density that a grid of azimuth and elevation gives it. A guess, right to some per cent of the
/// range.
/// @param patches  100 or more.
Eigen::Vector3d even_position(const std::vector<SurfacePatch>& patches, int axis,
                              const Progress& progress);

}  // namespace manip3d
