#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Points of a scan: metres, x forward, y left, z up (KITTI), unless a function says otherwise.
namespace manip3d {

using Points = Rows<float, 3>;  ///< (N, 3)
using Intensities = Eigen::Matrix<float, Eigen::Dynamic, 1>;

/// Points that own their memory. `intensity` has one value per point, or none.
struct PointCloud {
  Points points;
  Intensities intensity;
};

/// Borrowed points in any order, without further columns.
struct PointsView {
  template <typename Matrix>
  using Map = Eigen::Map<const Matrix>;

  Map<Points> points{nullptr, 0, 3};
  Map<Intensities> intensity{nullptr, 0};  ///< (N,), or (0,) if the scanner gave none.

  PointsView() = default;
  explicit PointsView(Map<Points> xyz, Map<Intensities> reflectance = {nullptr, 0})
      : points(xyz), intensity(reflectance) {}
  PointsView(const PointCloud& cloud)  // NOLINT(google-explicit-constructor): a view of a cloud
      : points(cloud.points.data(), cloud.points.rows(), 3),
        intensity(cloud.intensity.data(), cloud.intensity.rows()) {}
  // Eigen::Map has no rebinding assignment; a view is made once and passed by reference.
  PointsView(const PointsView&) = default;
  PointsView& operator=(const PointsView&) = delete;
  ~PointsView() = default;

  [[nodiscard]] std::int64_t num_points() const { return points.rows(); }
  [[nodiscard]] bool has_intensity() const { return intensity.rows() > 0; }
};

/// Checks the preconditions of all kernels: finite coordinates and intensities, as many intensities
/// as points or none, at most 2^31 - 1 points. Every public function with points calls it.
/// @throws InputError  naming the table, the row, the expected and the actual value.
void check_points(const PointsView& view);

}  // namespace manip3d
