#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/cell_list.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Return the numbers below `count` in a random order: sorted by random keys, ties by number.
std::vector<std::int32_t> random_order(std::int64_t count, std::uint64_t seed, Ticker& ticker);

/// Mean nearest-neighbour distance, estimated from a few thousand points to about 1 %. Points at
/// one place count once, because some scans store each point twice; 0 if there is one place only.
double mean_spacing(const PointsView& points, const Progress& progress);

inline PointsView view_of(const Points& points) {
  return PointsView({points.data(), points.rows(), 3});
}
Points take(const PointsView& view, const std::vector<std::int32_t>& rows);
/// The points without repetitions, in their order.
Points distinct(const PointsView& view);

/// Dart throwing [Cook, ACM TOG 1986] among given points, in a random order: a point is kept unless
/// a kept point is nearer than the radius. Each kept point marks its neighbours, which gives the
/// same result faster, because most points are not kept.
class DartBoard {
 public:
  /// @param origin  A place near the points; origin of the cells.
  DartBoard(const PointsView& candidates, std::uint64_t seed, const Eigen::Vector3d& origin,
            const Progress& progress)
      : candidates_(candidates),
        origin_(origin),
        progress_(progress),
        ticker_(progress),
        order_(random_order(candidates.num_points(), seed, ticker_)) {}

  /// Return the kept rows, ascending.
  std::vector<std::int32_t> sample(double radius);
  /// Mean spacing of the rows that the last sample kept, like `mean_spacing` of these points.
  [[nodiscard]] double mean_spacing_of(const std::vector<std::int32_t>& kept) const;

 private:
  enum class State : std::uint8_t { kFree, kNear, kStays };
  [[nodiscard]] double nearest_that_stays(std::int32_t place) const;

  PointsView candidates_;
  Eigen::Vector3d origin_;
  Progress progress_;
  Ticker ticker_;
  std::vector<std::int32_t> order_;
  std::optional<CellList> cells_;
  std::vector<State> state_;  ///< By place in the list.
};

}  // namespace manip3d
