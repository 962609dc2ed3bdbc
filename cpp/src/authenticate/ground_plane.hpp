#pragma once

#include <optional>

#include "manip3d/geometry/point_cloud.hpp"

namespace manip3d {

/// The plane z = slope_x x + slope_y y + height.
struct GroundPlane {
  double slope_x = 0.0, slope_y = 0.0, height = 0.0;
  [[nodiscard]] double above(double x, double y, double z) const {
    return z - slope_x * x - slope_y * y - height;
  }
};

/// Estimates the plane on which the scanner's vehicle stands, from points 4 to 25 m away and below
/// the scanner: the most frequent height, then least squares in a narrowing band around the plane.
/// Returns no plane if too few points agree.
std::optional<GroundPlane> find_ground_plane(const PointsView& points);

}  // namespace manip3d
