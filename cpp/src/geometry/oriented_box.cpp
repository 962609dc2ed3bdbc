#include "manip3d/geometry/oriented_box.hpp"

#include <cmath>
#include <limits>
#include <string>

#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {

using Eigen::Matrix3d;
using Eigen::Vector3d;

void check_box(const OrientedBox& box) {
  if (!(box.center.allFinite() && box.size.allFinite() && (box.size.array() >= 0.0).all())) {
    throw InputError("box: expected a finite center and sizes >= 0");
  }
  if (!(std::abs(box.yaw) <= 1e6)) {
    throw InputError("box: expected a yaw in radians, got " + number_text(box.yaw));
  }
}

std::vector<std::int32_t> points_in_box(const PointsView& view, const OrientedBox& box,
                                        int num_threads, const Progress& progress) {
  check_box(box);
  const Matrix3d to_box = rotation_about_z(box.yaw).transpose();
  const Vector3d half = 0.5 * box.size;
  // A slightly larger axis-parallel box around it, in float, excludes nearly all points quickly.
  const Vector3d reach = to_box.transpose().cwiseAbs() * half;
  const Vector3d slack = 1e-6 * (box.center.cwiseAbs() + reach);
  const Eigen::Vector3f low = (box.center - reach - slack).cast<float>();
  const Eigen::Vector3f high = (box.center + reach + slack).cast<float>();
  const auto inside = [=](float x, float y, float z) {
    if (x < low.x() || x > high.x() || y < low.y() || y > high.y() || z < low.z() || z > high.z()) {
      return false;
    }
    if (is_no_return(x, y, z)) return false;
    const Vector3d p = to_box * (Vector3d(x, y, z) - box.center);
    return (p.cwiseAbs().array() <= half.array()).all();
  };
  return select_rows(view, num_threads, inside, progress);
}

OrientedBox box_around(const PointsView& view, const std::vector<std::int32_t>& rows, double yaw) {
  OrientedBox box;
  box.yaw = yaw;
  if (rows.empty()) return box;
  const Matrix3d to_box = rotation_about_z(yaw).transpose();
  Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity());
  Vector3d high = -low;
  for (const std::int32_t row : rows) {
    const Vector3d p = to_box * view.points.row(row).transpose().cast<double>();
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  box.center = to_box.transpose() * (0.5 * (low + high));
  box.size = high - low;
  return box;
}

}  // namespace manip3d
