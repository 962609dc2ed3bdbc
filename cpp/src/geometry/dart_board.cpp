#include "geometry/dart_board.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "geometry/buckets.hpp"
#include "geometry/kd_tree.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kProbes = 2048;
// Size of a cell relative to the radius, which later corrections change.
constexpr double kRoom = 1.1;
constexpr double kSure = 1.99;  // cells to either side within which neighbours are certainly found

double square(double x) { return x * x; }

// Calls visit(i) for a few thousand of `count` items.
template <typename Visit>
std::int64_t for_probes(std::int64_t count, const Visit& visit) {
  const std::int64_t step = std::max<std::int64_t>(1, count / kProbes);
  for (std::int64_t i = 0; i < count; i += step) visit(i);
  return (count + step - 1) / step;
}

}  // namespace

Points distinct(const PointsView& view) {
  const auto coordinates = [&](std::int32_t row) {
    return std::array<float, 3>{view.points(row, 0), view.points(row, 1), view.points(row, 2)};
  };
  std::vector<std::int32_t> rows(static_cast<std::size_t>(view.num_points()));
  std::iota(rows.begin(), rows.end(), 0);
  std::sort(rows.begin(), rows.end(), [&](std::int32_t a, std::int32_t b) {
    return std::pair(coordinates(a), a) < std::pair(coordinates(b), b);
  });
  const auto is_same = [&](std::int32_t a, std::int32_t b) {
    return coordinates(a) == coordinates(b);
  };
  rows.erase(std::unique(rows.begin(), rows.end(), is_same), rows.end());
  std::sort(rows.begin(), rows.end());
  return take(view, rows);
}

double mean_spacing(const PointsView& points, const Progress& progress) {
  const KdTree tree(points, progress);
  double sum = 0.0;
  bool repeats = false;
  const std::int64_t count = for_probes(points.num_points(), [&](std::int64_t i) {
    const double distance = tree.nearest_distance(i);
    repeats = repeats || distance == 0.0;
    sum += distance;
  });
  if (!repeats) return sum / static_cast<double>(count);
  const Points places = distinct(points);
  return places.rows() < 2 ? 0.0 : mean_spacing(view_of(places), progress);
}

std::vector<std::int32_t> random_order(std::int64_t count, std::uint64_t seed, Ticker& ticker) {
  const int bits =
      std::clamp(static_cast<int>(std::bit_width(static_cast<std::uint64_t>(count))), 1, 24);
  // Sorted into buckets by the leading bits of the keys, then within each bucket.
  const auto key_of = [&](std::int32_t i) {
    return random_bits(seed, static_cast<std::uint64_t>(i));
  };
  Buckets<std::int32_t> buckets(std::int64_t{1} << bits, [&](const auto& put) {
    for (std::int32_t i = 0; i < count; ++i) {
      put(static_cast<std::int32_t>(key_of(i) >> (64 - bits)), i);
      ticker.tick();
    }
  });
  std::vector<std::int32_t> order;
  order.reserve(count);
  for (std::int32_t b = 0; b < buckets.num_keys(); ++b) {
    const auto few = buckets[b];
    std::sort(few.begin(), few.end(), [&](std::int32_t i, std::int32_t j) {
      return std::pair(key_of(i), i) < std::pair(key_of(j), j);
    });
    order.insert(order.end(), few.begin(), few.end());
    ticker.tick();
  }
  return order;
}

Points take(const PointsView& view, const std::vector<std::int32_t>& rows) {
  Points taken(static_cast<Eigen::Index>(rows.size()), 3);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    taken.row(static_cast<Eigen::Index>(i)) = view.points.row(rows[i]);
  }
  return taken;
}

std::vector<std::int32_t> DartBoard::sample(double radius) {
  if (!cells_ || !(radius <= cells_->cell_size() && cells_->cell_size() <= 2.0 * radius)) {
    cells_.emplace(candidates_, kRoom * radius, origin_, ticker_);
  }
  state_.assign(order_.size(), State::kFree);
  for (const std::int32_t row : order_) {
    ticker_.tick();
    const std::int32_t place = cells_->place_of(row);
    if (state_[place] != State::kFree) continue;
    cells_->visit<1>(place, [&](std::int32_t other) {
      if (cells_->squared_distance(place, other) < radius * radius) state_[other] = State::kNear;
    });
    state_[place] = State::kStays;
  }
  std::vector<std::int32_t> kept;
  for (std::int32_t row = 0; row < candidates_.num_points(); ++row) {
    if (state_[cells_->place_of(row)] == State::kStays) kept.push_back(row);
  }
  return kept;
}

double DartBoard::mean_spacing_of(const std::vector<std::int32_t>& kept) const {
  double sum = 0.0;
  bool all_near = true;
  const auto probes = for_probes(static_cast<std::int64_t>(kept.size()), [&](std::int64_t i) {
    const double squared = nearest_that_stays(cells_->place_of(kept[i]));
    all_near = all_near && squared <= kSure * kSure * square(cells_->cell_size());
    sum += std::sqrt(squared);
  });
  if (all_near) return sum / static_cast<double>(probes);
  // Some points have no neighbours in the cells around.
  return mean_spacing(view_of(take(candidates_, kept)), progress_);
}

double DartBoard::nearest_that_stays(std::int32_t place) const {
  double least = std::numeric_limits<double>::infinity();
  cells_->visit<2>(place, [&](std::int32_t other) {
    if (state_[other] != State::kStays || other == place) return;
    least = std::min(least, cells_->squared_distance(place, other));
  });
  return least;
}

}  // namespace manip3d
