#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// Evidence that the reflectances of a frame were assigned to the wrong points.
namespace manip3d {

struct ReflectanceContrast {
  std::int64_t edges = 0;     ///< Pairs of rows across an edge of the scene.
  std::int64_t surfaces = 0;  ///< Pairs of rows on one surface that are used: every third one.
  /// For each slip: mean squared difference of reflectances across edges, divided by that on
  /// surfaces; 0 if one kind of pairs is missing or surfaces have no differences.
  std::vector<double> contrast;
};

/// Compares the differences of reflectance across edges, where the range of a laser jumps, with
/// those on surfaces.
///
/// A pair is two rows of the file that are two apart, of one laser and in neighbouring directions;
/// they are two apart because odd and even firings may differ in reflectance. Differences are
/// clipped at 0.3 of the frame's scale. A slip of k gives each point the reflectance of the point k
/// rows later in the file, cyclically.
/// @param rings     (N,) the laser of each point; negative: unknown.
/// @param azimuths  (N,) radians.
/// @throws InputError  the points fail check_points or have no reflectances; another number of
///                     rings or azimuths than points.
ReflectanceContrast reflectance_contrast(const PointsView& points,
                                         std::span<const std::int32_t> rings,
                                         std::span<const float> azimuths,
                                         std::span<const std::int64_t> slips);

}  // namespace manip3d
