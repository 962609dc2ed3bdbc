#include "manip3d/authenticate/density.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <string>

#include "geometry/constants.hpp"
#include "geometry/directions.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

constexpr double kUnit = 1e-6;  // metres: unit of the sum of distances, which is a whole number
constexpr double kLongestGap = 1000.0;  // metres: larger nearest-neighbour distances are clipped
constexpr double kLookup = 0.005;       // metres: resolution of the table from ranges to levels
constexpr float kSteepest = 0.2F;  // smallest cosine of elevation by which distances are divided
constexpr std::int64_t kMaxCells = 1 << 26;

// Finds the sector and level of a point.
class LevelFinder {
 public:
  explicit LevelFinder(const DensityOptions& options) : options_(options) {
    check(options);
    for (double edge = 0.0; edge < options.max_range;) {
      edges_.push_back(edge);
      edge += std::max(options.level_width, options.level_growth * edge);
    }
    edges_.push_back(options.max_range);
    columns_ = options.sector > 0 ? 360 / options.sector : 1;
    rows_ = options.sector > 0 ? 180 / options.sector : 1;
    if (!(columns_ * rows_ * levels() <= kMaxCells)) {
      throw InputError("level_width: expected at most 2^26 cells of sectors and levels");
    }
    const auto steps = static_cast<std::int64_t>(options.max_range / kLookup) + 1;
    std::int64_t level = 0;
    for (std::int64_t i = 0; i < steps; ++i) {
      const double range = (static_cast<double>(i) + 0.5) * kLookup;
      while (level + 1 < levels() && range >= edges_[level + 1]) ++level;
      table_.push_back(static_cast<std::int32_t>(level));
    }
  }

  [[nodiscard]] std::int64_t sectors() const { return columns_ * rows_; }
  [[nodiscard]] std::int64_t levels() const { return static_cast<std::int64_t>(edges_.size()) - 1; }
  [[nodiscard]] const std::vector<double>& edges() const { return edges_; }

  // Calls visit(row, cell, cosine of the elevation) for each point of [begin, end) within range.
  template <typename Visit>
  void visit(const PointsView& view, std::int64_t begin, std::int64_t end,
             const Visit& visit_point) const {
    const auto visit_direction = [&](std::int64_t i, const Direction& direction) {
      const float range = direction.range;
      if (!(range > 0.0F && range < static_cast<float>(options_.max_range))) return;
      visit_point(i, sector_of(direction) * levels() + level_of(range), direction.rho / range);
    };
    for_each_direction(view.points.data(), 3, begin, end, options_.origin, visit_direction);
  }

 private:
  static void check(const DensityOptions& options) {
    if (!options.origin.allFinite()) throw InputError("origin: expected finite numbers");
    if (!(options.sector >= 0 && (options.sector == 0 || 180 % options.sector == 0))) {
      throw InputError("sector: expected 0 or whole degrees that divide 180, got " +
                       std::to_string(options.sector));
    }
    if (!(options.level_width >= kLookup && options.level_growth >= 0.0 &&
          options.level_growth <= 1.0)) {
      throw InputError("level_width: expected at least 0.005 m, and a growth of 0 to 1");
    }
    if (!(options.max_range > options.level_width && options.max_range <= 1e4)) {
      throw InputError("max_range: expected more than a level, and at most 10000 m, got " +
                       number_text(options.max_range));
    }
  }

  // A range just below the largest can round up to the table's size, which double counted.
  [[nodiscard]] std::int64_t level_of(float range) const {
    const auto step = static_cast<std::size_t>(range * static_cast<float>(1.0 / kLookup));
    return table_[std::min(step, table_.size() - 1)];
  }

  [[nodiscard]] std::int64_t sector_of(const Direction& direction) const {
    const auto cell = [](double angle, std::int64_t count, double whole) {
      const auto i = static_cast<std::int64_t>(angle / whole * static_cast<double>(count));
      return std::clamp(i, std::int64_t{0}, count - 1);
    };
    return cell(direction.elevation + kPi / 2.0, rows_, kPi) * columns_ +
           cell(direction.azimuth + kPi, columns_, 2.0 * kPi);
  }

  DensityOptions options_;
  std::vector<double> edges_;
  std::vector<std::int32_t> table_;
  std::int64_t columns_ = 1, rows_ = 1;
};

// The sums are whole numbers, which neither NaN nor a negative distance fits. A point without
// neighbours has an infinite distance.
void check_distances(std::span<const double> distances) {
  for (std::size_t i = 0; i < distances.size(); ++i) {
    if (distances[i] >= 0.0) continue;
    throw InputError("distances: expected at least 0, got " + number_text(distances[i]) +
                     " in row " + std::to_string(i));
  }
}

}  // namespace

DensityLevels density_levels(const PointsView& view, std::span<const double> distances,
                             const DensityOptions& options, const Progress& progress) {
  check_points_everywhere(view, options.num_threads, progress);
  if (static_cast<std::int64_t>(distances.size()) != view.num_points()) {
    throw InputError("distances: expected " + std::to_string(view.num_points()) + ", got " +
                     std::to_string(distances.size()));
  }
  check_distances(distances);
  const LevelFinder finder(options);
  DensityLevels result;
  result.sectors = finder.sectors();
  result.edges = finder.edges();
  const std::size_t size = finder.sectors() * finder.levels();
  result.counts.assign(size, 0);
  std::vector<std::int64_t> sums(size);
  const auto sum_up = [&](std::int64_t begin, std::int64_t end) {
    finder.visit(view, begin, end, [&](std::int64_t i, std::int64_t cell, float cosine) {
      double distance = std::min(distances[i], kLongestGap);
      if (options.level_out) distance /= std::max(cosine, kSteepest);
      const auto units = static_cast<std::int64_t>(distance / kUnit + 0.5);
      std::atomic_ref(sums[cell]).fetch_add(units, std::memory_order_relaxed);
      std::atomic_ref(result.counts[cell]).fetch_add(1, std::memory_order_relaxed);
    });
  };
  parallel_chunks(view.num_points(), kPointChunk, options.num_threads, sum_up, progress);
  result.means.assign(size, 0.0);
  for (std::size_t c = 0; c < size; ++c) {
    if (result.counts[c] > 0) {
      result.means[c] = kUnit * static_cast<double>(sums[c]) / result.counts[c];
    }
  }
  return result;
}

std::vector<std::int32_t> points_of_levels(const PointsView& view,
                                           std::span<const std::uint8_t> marked,
                                           const DensityOptions& options,
                                           const Progress& progress) {
  check_points_everywhere(view, options.num_threads, progress);
  const LevelFinder finder(options);
  if (static_cast<std::int64_t>(marked.size()) != finder.sectors() * finder.levels()) {
    throw InputError("marked: expected one mark per sector and level, got " +
                     std::to_string(marked.size()));
  }
  std::vector<std::int32_t> rows;
  Ticker ticker(progress, 1U << 16);
  finder.visit(view, 0, view.num_points(), [&](std::int64_t i, std::int64_t cell, float) {
    ticker.tick();
    if (marked[cell] != 0) rows.push_back(static_cast<std::int32_t>(i));
  });
  return rows;
}

}  // namespace manip3d
