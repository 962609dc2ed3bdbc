#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// Evidence that the reflectances of a frame are those of other points.
namespace manip3d {

struct ReflectanceContrast {
  std::int64_t edges = 0;     ///< Pairs of rows over an edge.
  std::int64_t surfaces = 0;  ///< Pairs of rows on one surface, of those that were looked at.
  /// For each slip: mean squared difference of reflectances over edges, as a multiple of that on
  /// surfaces; 0 where there are no pairs of both kinds or no differences on surfaces.
  std::vector<double> contrast;
};

/// Compares how reflectances differ over edges, where the range of a laser jumps, with how they
/// differ on surfaces.
///
/// Pairs are of rows two apart in the file, of one laser, in directions next to each other: odd and
/// even firings may differ in reflectance. Differences are clipped at 0.3 of the frame's scale. A
/// slip of k gives each point the reflectance k rows behind it in the file, the first ones
/// following the last.
/// @param rings     (N,) the laser of each point; negative: none.
/// @param azimuths  (N,) radians.
/// @throws InputError  what check_points refuses; points without reflectances; rings or azimuths of
///                     another number of points.
ReflectanceContrast reflectance_contrast(const PointsView& points,
                                         std::span<const std::int32_t> rings,
                                         std::span<const float> azimuths,
                                         std::span<const std::int64_t> slips);

}  // namespace manip3d
