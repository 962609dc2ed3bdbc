#include "manip3d/geometry/point_cloud.hpp"

#include <cmath>
#include <limits>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Infinity and NaN times zero are NaN, and so is any sum with such a term. This allows a fast test
// of all values, and a slow search only if it fails.
template <typename Table>
void check_finite_rows(const Table& table, const char* name) {
  if (((table.array() * 0.0F).sum() == 0.0F)) return;
  for (Eigen::Index row = 0; row < table.rows(); ++row) {
    for (Eigen::Index column = 0; column < table.cols(); ++column) {
      const float value = table(row, column);
      if (std::isfinite(value)) continue;
      throw InputError(std::string(name) + ": expected finite numbers, got " + number_text(value) +
                       " in row " + std::to_string(row));
    }
  }
}

}  // namespace

void check_points(const PointsView& view) {
  if (view.num_points() > std::numeric_limits<std::int32_t>::max()) {
    throw InputError("points: expected at most 2147483647 rows, got " +
                     std::to_string(view.num_points()));
  }
  if (view.has_intensity() && view.intensity.rows() != view.num_points()) {
    throw InputError("intensity: expected " + std::to_string(view.num_points()) + " values, got " +
                     std::to_string(view.intensity.rows()));
  }
  check_finite_rows(view.points, "points");
  check_finite_rows(view.intensity, "intensity");
}

}  // namespace manip3d
