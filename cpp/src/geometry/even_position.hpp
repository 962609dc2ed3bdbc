#pragma once

#include <Eigen/Core>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// A small piece of the scanned surface.
struct SurfacePatch {
  Eigen::Vector3d place;   ///< Metres.
  Eigen::Vector3d normal;  ///< Unit length; its sign is arbitrary.
  double density = 0.0;    ///< Points per square metre.
};

/// Make patches around random points, each from the point's nearest neighbours. Neighbours on a
/// line give no patch.
std::vector<SurfacePatch> sample_patches(const Points& points, const Progress& progress);

/// Estimate the position of a scanner that rotates about `axis` (0, 1, 2): the position from which
/// each patch has the density that a grid of azimuth and elevation gives it. Accurate to some per
/// cent of the range.
/// @param patches  At least 100.
Eigen::Vector3d even_position(const std::vector<SurfacePatch>& patches, int axis,
                              const Progress& progress);

}  // namespace manip3d
