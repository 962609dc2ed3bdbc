#include "manip3d/geometry/nearest_neighbours.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "geometry/constants.hpp"
#include "geometry/directions.hpp"
#include "geometry/kd_tree.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

constexpr double kMargin = 4.0 * kAngleError;  // added to every bound, for errors of the angles
constexpr std::int64_t kFewPoints = 1000;      // for fewer points a k-d tree is as fast
constexpr std::int64_t kMaxCells = 1 << 28;
// Mean number of points in a point's own cell, above which the grid is not used.
constexpr double kCrowded = 32.0;
// Cells to each side; for wider windows, blocks are searched.
constexpr std::int64_t kWidestWindow = 16;
constexpr std::int64_t kBlockSide = 16;  // cells
// Cells; windows start at most this far before the first cell.
constexpr std::int64_t kAhead = 1 << 20;
constexpr std::int64_t kSampleSize = 1 << 16;

// A lower bound of the sine on [0, pi/2].
double sine_bound(double angle) {
  const double a = std::clamp(angle, 0.0, kPi / 2.0);
  return a - a * a * a / 6.0;
}

// Upper bound of asin(s) for s below kNearSine.
constexpr double kNearSine = 0.4;
double arc_sine_bound(double s) { return 1.03 * s; }

struct Item {
  float x, y, z;
  std::int32_t row;
};

// Points by their direction from the scanner: rows of equal elevation, which are divided into cells
// by azimuth. Counting sort; the order within a cell depends on the threads, but the distances do
// not.
class DirectionGrid {
 public:
  DirectionGrid(const PointsView& view, const Vector3d& origin, double resolution, int threads,
                const Progress& progress)
      : view_(view), origin_(origin), threads_(threads) {
    if (!(resolution > 0.0)) resolution = resolution_of_sample();
    const double most = std::sqrt(static_cast<double>(
        std::min(kMaxCells, std::max<std::int64_t>(1024, 8 * view.num_points()))));
    columns_ = static_cast<std::int64_t>(std::clamp(2.0 * kPi / resolution, 8.0, most));
    rows_ = std::max<std::int64_t>(4, columns_ / 2);
    azimuth_step_ = 2.0 * kPi / static_cast<double>(columns_);
    elevation_step_ = kPi / static_cast<double>(rows_);
    columns_per_radian_ = 1.0 / azimuth_step_;
    rows_per_radian_ = 1.0 / elevation_step_;
    count_cells(progress);
  }

  /// Mean number of points in a point's own cell.
  [[nodiscard]] double crowding() const { return crowding_; }

  void sort(const Progress& progress);

  [[nodiscard]] std::int64_t row_of(double elevation) const {
    return std::clamp(static_cast<std::int64_t>((elevation + kPi / 2.0) / elevation_step_),
                      std::int64_t{0}, rows_ - 1);
  }
  [[nodiscard]] std::int64_t column_of(double azimuth) const {
    return std::clamp(static_cast<std::int64_t>((azimuth + kPi) / azimuth_step_), std::int64_t{0},
                      columns_ - 1);
  }

  LargeArray<double> distances(const Progress& progress);

 private:
  struct Query {
    std::int64_t item;
    float x, y, z;
    double range, rho, azimuth, elevation;
    std::int64_t row, column;
    double best = kInfinity;    // squared
    float cutoff = kInfinityF;  // slightly larger than `best`
  };
  struct Window {
    std::int64_t low, high, left, right;  // first and last row, first and last column
  };
  struct Block {
    float nearest = kInfinityF;
    float farthest = 0.0F;
  };

  double resolution_of_sample() const;
  void count_cells(const Progress& progress);
  template <typename Visit>
  void for_each_item(std::int64_t begin, std::int64_t end, const Visit& visit) const;

  void scan(Query& query, std::int64_t begin, std::int64_t end) const;
  void scan_columns(Query& query, std::int64_t row, std::int64_t first, std::int64_t last) const;
  void scan_rows(Query& query, std::int64_t low, std::int64_t high, std::int64_t left,
                 std::int64_t right) const;
  [[nodiscard]] std::optional<Window> window_of(const Query& query) const;
  bool search_nearby(Query& query) const;
  void build_blocks(const Progress& progress);
  void search_blocks(Query& query) const;
  [[nodiscard]] double block_bound(const Query& query, std::int64_t row, std::int64_t column) const;
  void scan_block(Query& query, std::int64_t row, std::int64_t column) const;

  const PointsView& view_;
  Vector3d origin_;
  int threads_;
  std::int64_t rows_ = 0, columns_ = 0;
  double azimuth_step_ = 0.0, elevation_step_ = 0.0;
  double columns_per_radian_ = 0.0, rows_per_radian_ = 0.0;
  double crowding_ = 0.0;
  LargeArray<std::int32_t> cells_;   // cell of each point of the view
  LargeArray<std::int32_t> starts_;  // index of each cell's first item; one more at the end
  LargeArray<Item> items_;
  std::int64_t block_rows_ = 0, block_columns_ = 0;
  std::vector<Block> blocks_;
};

// A resolution of about one point per cell. The share of 1-degree cells that a sample occupies is
// the scanned share of the sphere.
double DirectionGrid::resolution_of_sample() const {
  const std::int64_t count = view_.num_points();
  const std::int64_t step = std::max<std::int64_t>(1, count / kSampleSize);
  std::vector<std::uint8_t> seen(360 * 180);
  std::int64_t occupied = 0;
  Directions directions;
  for (std::int64_t i = 0; i < count; i += step) {
    directions.compute(view_.points.data() + 3 * i, 3, 1, origin_);
    const double degree = 180.0 / kPi;
    const auto column =
        std::clamp(static_cast<std::int64_t>(directions.azimuth[0] * degree + 180.0),
                   std::int64_t{0}, std::int64_t{359});
    const auto row = std::clamp(static_cast<std::int64_t>(directions.elevation[0] * degree + 90.0),
                                std::int64_t{0}, std::int64_t{179});
    std::uint8_t& cell = seen[row * 360 + column];
    occupied += cell == 0 ? 1 : 0;
    cell = 1;
  }
  const double area = static_cast<double>(occupied) * (kPi / 180.0) * (kPi / 180.0);
  return std::sqrt(area / static_cast<double>(count));
}

void DirectionGrid::count_cells(const Progress& progress) {
  const std::int64_t count = view_.num_points();
  cells_ = LargeArray<std::int32_t>(count);
  starts_ = LargeArray<std::int32_t>(rows_ * columns_ + 1);
  std::int32_t* starts = starts_.data();
  parallel_chunks(starts_.size(), kPointChunk, threads_, [&](std::int64_t begin, std::int64_t end) {
    std::fill(starts + begin, starts + end, 0);
  });
  const auto count_one = [&](std::int64_t i, const Direction& direction) {
    const auto cell = static_cast<std::int32_t>(row_of(direction.elevation) * columns_ +
                                                column_of(direction.azimuth));
    cells_[i] = cell;
    std::atomic_ref(starts[cell]).fetch_add(1, std::memory_order_relaxed);
  };
  const auto count_some = [&](std::int64_t begin, std::int64_t end) {
    for_each_direction(view_.points.data(), 3, begin, end, origin_, count_one);
  };
  parallel_chunks(count, kPointChunk, threads_, count_some, progress);
  Ticker ticker(progress, 1U << 20);
  std::int64_t sum = 0;
  double squares = 0.0;
  for (std::int64_t c = 0; c < starts_.size(); ++c) {  // counts become the ends of the cells
    ticker.tick();
    const std::int64_t size = starts[c];
    squares += static_cast<double>(size * size);
    sum += size;
    starts[c] = static_cast<std::int32_t>(sum);
  }
  crowding_ = squares / static_cast<double>(std::max<std::int64_t>(count, 1));
}

void DirectionGrid::sort(const Progress& progress) {
  items_ = LargeArray<Item>(view_.num_points());
  std::int32_t* ends = starts_.data();
  const auto sort_some = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const std::int32_t place =
          std::atomic_ref(ends[cells_[i]]).fetch_sub(1, std::memory_order_relaxed) - 1;
      items_[place] = {view_.points(i, 0), view_.points(i, 1), view_.points(i, 2),
                       static_cast<std::int32_t>(i)};
    }
  };
  parallel_chunks(view_.num_points(), kPointChunk, threads_, sort_some, progress);
  cells_ = {};
}

// Tests the items [begin, end), first in float, whose relative error is below 1e-6.
void DirectionGrid::scan(Query& query, std::int64_t begin, std::int64_t end) const {
  for (std::int64_t i = begin; i < end; ++i) {
    const Item& item = items_[i];
    const float fx = query.x - item.x;
    const float fy = query.y - item.y;
    const float fz = query.z - item.z;
    if (fx * fx + fy * fy + fz * fz > query.cutoff || i == query.item) continue;
    const double dx = static_cast<double>(query.x) - item.x;
    const double dy = static_cast<double>(query.y) - item.y;
    const double dz = static_cast<double>(query.z) - item.z;
    const double squared = dx * dx + dy * dy + dz * dz;
    if (squared < query.best) {
      query.best = squared;
      query.cutoff = static_cast<float>(squared * 1.000002) + 1e-37F;
    }
  }
}

// Scans the columns first to last of a row, which may wrap around; at most one turn.
void DirectionGrid::scan_columns(Query& query, std::int64_t row, std::int64_t first,
                                 std::int64_t last) const {
  const std::int32_t* starts = starts_.data() + row * columns_;
  if (last - first + 1 >= columns_) return scan(query, starts[0], starts[columns_]);
  if (last < 0) {
    first += columns_, last += columns_;
  } else if (first >= columns_) {
    first -= columns_, last -= columns_;
  }
  if (first < 0) {
    scan(query, starts[first + columns_], starts[columns_]);
    first = 0;
  }
  if (last >= columns_) {
    scan(query, starts[0], starts[last - columns_ + 1]);
    last = columns_ - 1;
  }
  scan(query, starts[first], starts[last + 1]);
}

// The cells that contain all points nearer than the query's best; no value if the best is too far.
std::optional<DirectionGrid::Window> DirectionGrid::window_of(const Query& query) const {
  const double best = std::sqrt(query.best) * (1.0 + 1e-6);
  // The negated < also catches NaN: a point at the scanner's own position has no direction (0 / 0).
  if (!(best < kNearSine * query.rho)) return std::nullopt;
  const double up = arc_sine_bound(best / query.range) + kMargin;
  const double across = arc_sine_bound(best / query.rho) + kMargin;
  const auto to_cell = [](double angle, double per_radian) {
    return static_cast<std::int64_t>(angle * per_radian + kAhead) - kAhead;  // floor
  };
  return Window{to_cell(query.elevation + kPi / 2.0 - up, rows_per_radian_),
                to_cell(query.elevation + kPi / 2.0 + up, rows_per_radian_),
                to_cell(query.azimuth + kPi - across, columns_per_radian_),
                to_cell(query.azimuth + kPi + across, columns_per_radian_)};
}

// Searches the cells left and right of the query's cell, then the window that their best leaves
// open; if that is wide, first the cells above and below. Returns false if the window stays too
// wide.
bool DirectionGrid::search_nearby(Query& query) const {
  const std::int64_t row = query.row;
  const std::int64_t column = query.column;
  scan_columns(query, row, column - 1, column + 1);
  std::optional<Window> window = window_of(query);
  const auto within_one = [&](const Window& w) {
    return w.low >= row - 1 && w.high <= row + 1 && w.left >= column - 1 && w.right <= column + 1;
  };
  if (window && within_one(*window)) {
    scan_rows(query, window->low, row - 1, window->left, window->right);
    scan_rows(query, row + 1, window->high, window->left, window->right);
    return true;
  }
  scan_rows(query, row - 1, row - 1, column - 1, column + 1);
  scan_rows(query, row + 1, row + 1, column - 1, column + 1);
  window = window_of(query);
  if (!window) return query.best == 0.0;
  if (within_one(*window)) return true;
  const auto [low, high, left, right] = *window;
  if (high - low > 2 * kWidestWindow || right - left > 2 * kWidestWindow) return false;
  scan_rows(query, low, row - 2, left, right);
  scan_rows(query, std::max(low, row - 1), std::min(high, row + 1), left, column - 2);
  scan_rows(query, std::max(low, row - 1), std::min(high, row + 1), column + 2, right);
  scan_rows(query, row + 2, high, left, right);
  return true;
}

void DirectionGrid::scan_rows(Query& query, std::int64_t low, std::int64_t high, std::int64_t left,
                              std::int64_t right) const {
  if (left > right) return;
  for (std::int64_t row = std::max<std::int64_t>(0, low); row <= std::min(rows_ - 1, high); ++row) {
    scan_columns(query, row, left, right);
  }
}

void DirectionGrid::build_blocks(const Progress& progress) {
  block_rows_ = (rows_ + kBlockSide - 1) / kBlockSide;
  block_columns_ = (columns_ + kBlockSide - 1) / kBlockSide;
  blocks_.assign(block_rows_ * block_columns_, {});
  const auto build = [&](std::int64_t first_row, std::int64_t) {
    Directions directions;
    for (std::int64_t row = first_row * kBlockSide;
         row < std::min(rows_, (first_row + 1) * kBlockSide); ++row) {
      for (std::int64_t column = 0; column < columns_; ++column) {
        const std::int64_t cell = row * columns_ + column;
        Block& block = blocks_[first_row * block_columns_ + column / kBlockSide];
        for (std::int64_t i = starts_[cell]; i < starts_[cell + 1]; ++i) {
          directions.compute(&items_[i].x, 4, 1, origin_);
          block.nearest = std::min(block.nearest, directions.range[0]);
          block.farthest = std::max(block.farthest, directions.range[0]);
        }
      }
    }
  };
  parallel_chunks(block_rows_, 1, threads_, build, progress);
}

// Lower bound of the distance of the block's points from the query.
double DirectionGrid::block_bound(const Query& query, std::int64_t row, std::int64_t column) const {
  const Block& block = blocks_[row * block_columns_ + column];
  if (!(block.nearest <= block.farthest)) return kInfinity;
  const double side = static_cast<double>(kBlockSide);
  const double bottom = static_cast<double>(row) * side * elevation_step_;
  const double elevation = query.elevation + kPi / 2.0;
  const double up = std::max(bottom - elevation, elevation - (bottom + side * elevation_step_));
  const double left = static_cast<double>(column) * side * azimuth_step_;
  const double right =
      std::min(left + side * azimuth_step_, static_cast<double>(columns_) * azimuth_step_);
  const double azimuth = query.azimuth + kPi;
  double across = 0.0;
  if (azimuth < left || azimuth > right) {
    const double one_way = azimuth < left ? left - azimuth : azimuth - right;
    const double other_way = 2.0 * kPi - (azimuth < left ? right - azimuth : azimuth - left);
    across = std::min(one_way, other_way);
  }
  const double slack = 1.0 - 1e-6;
  return slack *
         std::max({query.range * sine_bound(up - kMargin), query.rho * sine_bound(across - kMargin),
                   slack * block.nearest - query.range * (2.0 - slack),
                   slack * query.range - block.farthest * (2.0 - slack)});
}

void DirectionGrid::scan_block(Query& query, std::int64_t row, std::int64_t column) const {
  const std::int64_t last_row = std::min(rows_, (row + 1) * kBlockSide);
  const std::int64_t last = std::min(columns_, (column + 1) * kBlockSide) - 1;
  for (std::int64_t r = row * kBlockSide; r < last_row; ++r) {
    scan_columns(query, r, column * kBlockSide, last);
  }
}

// Searches blocks in growing squares around the query's block, until a whole square is too far
// away.
void DirectionGrid::search_blocks(Query& query) const {
  const std::int64_t row = query.row / kBlockSide;
  const std::int64_t column = query.column / kBlockSide;
  const std::int64_t half_turn = block_columns_ / 2;
  const std::int64_t largest = std::max(block_rows_, half_turn + 1);
  const auto consider = [&](std::int64_t r, std::int64_t offset) {
    if (r < 0 || r >= block_rows_) return kInfinity;
    const std::int64_t c = ((column + offset) % block_columns_ + block_columns_) % block_columns_;
    const double bound = block_bound(query, r, c);
    if (bound * bound < query.best) scan_block(query, r, c);
    return bound;
  };
  // Lower bounds for whole squares: by elevation above and below, by azimuth left and right. The
  // last block of a row, which may be narrow, is in between.
  const double side = static_cast<double>(kBlockSide);
  for (std::int64_t k = 0; k <= largest; ++k) {
    const double gap = static_cast<double>(k - 1) * side;
    const double narrow_gap = static_cast<double>(k - 2) * side;
    const double up = row - k < 0 && row + k >= block_rows_
                          ? kInfinity
                          : query.range * sine_bound(gap * elevation_step_ - kMargin);
    const double across = k > half_turn + 1
                              ? kInfinity
                              : query.rho * sine_bound(narrow_gap * azimuth_step_ - kMargin);
    const double bound = std::min(up, across) * (1.0 - 1e-6);
    if (k > 0 && bound * bound >= query.best) return;
    const std::int64_t width = std::min(k, half_turn);
    for (std::int64_t offset = -width; offset <= width; ++offset) {
      consider(row - k, offset);
      if (k > 0) consider(row + k, offset);
    }
    for (std::int64_t r = row - k + 1; r < row + k && k <= half_turn; ++r) {
      consider(r, -k);
      consider(r, k);
    }
  }
}

// Calls visit(query) for the items [begin, end).
template <typename Visit>
void DirectionGrid::for_each_item(std::int64_t begin, std::int64_t end, const Visit& visit) const {
  const auto visit_item = [&](std::int64_t i, const Direction& direction) {
    const Item& item = items_[i];
    Query query{i,
                item.x,
                item.y,
                item.z,
                direction.range,
                direction.rho,
                direction.azimuth,
                direction.elevation,
                row_of(direction.elevation),
                column_of(direction.azimuth)};
    visit(query);
  };
  for_each_direction(&items_[0].x, 4, begin, end, origin_, visit_item);
}

LargeArray<double> DirectionGrid::distances(const Progress& progress) {
  const std::int64_t count = view_.num_points();
  LargeArray<double> distances(count);
  std::vector<std::vector<std::int64_t>> hard((count + kPointChunk - 1) / kPointChunk);
  parallel_chunks(
      count, kPointChunk, threads_,
      [&](std::int64_t begin, std::int64_t end) {
        for_each_item(begin, end, [&](Query& query) {
          if (!search_nearby(query)) hard[begin / kPointChunk].push_back(query.item);
          distances[items_[query.item].row] = std::sqrt(query.best);
        });
      },
      part_of(progress, 0.3, 0.9));
  std::vector<std::int64_t> rest;
  for (const auto& part : hard) rest.insert(rest.end(), part.begin(), part.end());
  if (rest.empty()) return distances;
  build_blocks(part_of(progress, 0.9, 0.9));
  parallel_chunks(
      static_cast<std::int64_t>(rest.size()), 16, threads_,  // each may search many blocks
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          for_each_item(rest[k], rest[k] + 1, [&](Query& query) {
            search_blocks(query);
            distances[items_[query.item].row] = std::sqrt(query.best);
          });
        }
      },
      part_of(progress, 0.9, 1.0));
  return distances;
}

LargeArray<double> tree_distances(const PointsView& view, int threads, const Progress& progress) {
  LargeArray<double> distances(view.num_points());
  const KdTree tree(view, part_of(progress, 0.1, 0.1));
  parallel_chunks(
      view.num_points(), 1024, threads,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) distances[i] = tree.nearest_distance(i);
      },
      part_of(progress, 0.3, 1.0));
  return distances;
}

}  // namespace

LargeArray<double> nearest_distances(const PointsView& view, const NearestOptions& options,
                                     const Progress& progress) {
  check_points_everywhere(view, options.num_threads, part_of(progress, 0.0, 0.1));
  if (options.origin && !options.origin->allFinite()) {
    throw InputError("origin: expected finite numbers");
  }
  if (!(options.resolution >= 0.0 && options.resolution <= kPi)) {
    throw InputError("resolution: expected 0 to pi radians, got " +
                     number_text(options.resolution));
  }
  if (!options.origin || view.num_points() < kFewPoints) {
    return tree_distances(view, options.num_threads, progress);
  }
  DirectionGrid grid(view, *options.origin, options.resolution, options.num_threads,
                     part_of(progress, 0.1, 0.2));
  if (grid.crowding() > kCrowded) return tree_distances(view, options.num_threads, progress);
  grid.sort(part_of(progress, 0.2, 0.3));
  return grid.distances(progress);
}

}  // namespace manip3d
