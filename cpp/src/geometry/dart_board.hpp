#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/cell_list.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The numbers below `count` in a random order: by random keys, a tie by the number.
std::vector<std::int32_t> random_order(std::int64_t count, std::uint64_t seed, Ticker& ticker);

/// Mean nearest-neighbour distance, of a few thousand of the points: good to about 1 %.
double mean_spacing(const PointsView& points, const Progress& progress);

inline PointsView view_of(const Points& points) {
  return PointsView({points.data(), points.rows(), 3});
}
Points take(const PointsView& view, const std::vector<std::int32_t>& rows);

/// Dart throwing [Cook, ACM TOG 1986] among given points, in a random order: a point stays unless
/// one that stayed is nearer than the radius. Those that stay tell their neighbours, which is the
/// same and quicker: most do not stay.
class DartBoard {
 public:
  /// @param origin  near the points: cells are counted from there.
  DartBoard(const PointsView& candidates, std::uint64_t seed, const Eigen::Vector3d& origin,
            const Progress& progress)
      : candidates_(candidates),
        origin_(origin),
        progress_(progress),
        ticker_(progress),
        order_(random_order(candidates.num_points(), seed, ticker_)) {}

  /// The rows that stay, ascending.
  std::vector<std::int32_t> sample(double radius);
  /// Mean spacing of the rows that the last sample kept; as `mean_spacing` of them.
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
