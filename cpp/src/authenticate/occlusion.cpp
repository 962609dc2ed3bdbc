#include "manip3d/authenticate/occlusion.hpp"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <functional>
#include <span>
#include <string>
#include <utility>

#include "authenticate/cell_mask.hpp"
#include "geometry/constants.hpp"
#include "geometry/directions.hpp"
#include "geometry/median.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/connected_runs.hpp"
#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kMaxRays = 1 << 28;
constexpr float kNothing = kInfinityF;
// rows around those with points: more than closing and median reach
constexpr std::int64_t kEmptyRows = 4;
constexpr std::int32_t kNowhere = -1;  // cell of a point at the origin, which has no direction

void check_options(const OcclusionOptions& options) {
  const ScanGrid& grid = options.grid;
  const auto is_step = [](double step) { return step > 0.0 && step <= kPi / 4.0; };
  if (!(is_step(grid.azimuth_step) && is_step(grid.elevation_step) &&
        std::isfinite(grid.azimuth_phase) && std::isfinite(grid.elevation_phase))) {
    throw InputError("grid: expected steps above 0 and up to 45 degrees");
  }
  if (!(2.0 * kPi / grid.azimuth_step * kPi / grid.elevation_step < kMaxRays)) {
    throw InputError("grid: expected at most 2^28 cells");
  }
  if (!options.origin.allFinite()) throw InputError("origin: expected finite numbers");
  if (!(options.min_gap > 0.0)) {
    throw InputError("min_gap: expected > 0, got " + number_text(options.min_gap));
  }
  if (!(options.min_cells >= 1 && options.min_area >= 0.0 && options.max_range > 0.0)) {
    throw InputError("min_cells, min_area, max_range: expected at least 1, >= 0 and > 0");
  }
}

// Finds the image cells of points.
class CellFinder {
 public:
  explicit CellFinder(const OcclusionOptions& options)
      : origin_(options.origin),
        columns_(options.grid.columns()),
        rows_(options.grid.rows()),
        azimuth_scale_(static_cast<float>(1.0 / options.grid.azimuth_step)),
        elevation_scale_(static_cast<float>(1.0 / options.grid.elevation_step)) {
    // Cells are centred on the phases; the first one begins at or below -180 and -90 degrees.
    const auto offset = [](double phase, double step, double low) {
      const double periods = (phase - low) / step;
      return low + (periods - std::floor(periods) - 0.5) * step;
    };
    const double left = offset(options.grid.azimuth_phase, options.grid.azimuth_step, -kPi);
    left_ = static_cast<float>(left > -kPi ? left - options.grid.azimuth_step : left);
    const double low = offset(options.grid.elevation_phase, options.grid.elevation_step, -kPi / 2);
    low_ = static_cast<float>(low > -kPi / 2.0 ? low - options.grid.elevation_step : low);
  }

  /// Crops the rows below and above all points, except kEmptyRows of them.
  void crop(double lowest, double highest) {
    const auto row_of = [&](double elevation) {
      return static_cast<std::int64_t>((elevation - low_) * elevation_scale_);
    };
    const std::int64_t end = std::min(rows_, row_of(highest) + 1 + kEmptyRows);
    first_row_ = std::clamp(row_of(lowest) - kEmptyRows, std::int64_t{0}, end - 1);
    rows_ = end - first_row_;
  }

  [[nodiscard]] std::int64_t columns() const { return columns_; }
  [[nodiscard]] std::int64_t rows() const { return rows_; }
  [[nodiscard]] std::int64_t first_row() const { return first_row_; }
  [[nodiscard]] double elevation_of(std::int64_t row) const {
    return low_ + (static_cast<double>(first_row_ + row) + 0.5) / elevation_scale_;
  }

  // Calls visit(row of the point, cell, range) for each point of [begin, end).
  template <typename Visit>
  void visit(const PointsView& view, std::int64_t begin, std::int64_t end,
             const Visit& visit_point) const {
    const auto visit_direction = [&](std::int64_t i, const Direction& direction) {
      visit_point(i, direction.range > 0.0F ? cell(direction) : kNowhere, direction.range);
    };
    for_each_direction(view.points.data(), 3, begin, end, origin_, visit_direction);
  }

 private:
  [[nodiscard]] std::int32_t cell(const Direction& direction) const {
    auto column = static_cast<std::int64_t>((direction.azimuth - left_) * azimuth_scale_);
    const auto row =
        static_cast<std::int64_t>((direction.elevation - low_) * elevation_scale_) - first_row_;
    if (column >= columns_) column -= columns_;
    return static_cast<std::int32_t>(std::clamp(row, std::int64_t{0}, rows_ - 1) * columns_ +
                                     std::clamp(column, std::int64_t{0}, columns_ - 1));
  }

  Eigen::Vector3d origin_;
  std::int64_t columns_, rows_;
  std::int64_t first_row_ = 0;
  float azimuth_scale_, elevation_scale_;
  float left_ = 0.0F, low_ = 0.0F;
};

double angle_of_slope(double slope) {
  return std::isinf(slope) ? std::copysign(kPi / 2.0, slope) : arc_tangent(slope, 1.0);
}

// Approximately the lowest and the highest elevation of the points, from the tangents.
std::pair<double, double> elevations(const PointsView& view, const Eigen::Vector3d& origin,
                                     int num_threads, const Progress& progress) {
  const std::int64_t chunks = (view.num_points() + kPointChunk - 1) / kPointChunk;
  std::vector<float> least(chunks, kNothing);
  std::vector<float> most(chunks, -kNothing);
  const auto bound = [&](std::int64_t begin, std::int64_t end) {
    float low = kNothing;
    float high = -kNothing;
    for (std::int64_t i = begin; i < end; ++i) {
      const Eigen::Vector3f p =
          (view.points.row(i).transpose().cast<double>() - origin).cast<float>();
      const float slope = p.z() / std::sqrt(p.x() * p.x() + p.y() * p.y());
      low = slope < low ? slope : low;  // the slope of a point at the origin is NaN
      high = slope > high ? slope : high;
    }
    least[begin / kPointChunk] = low;
    most[begin / kPointChunk] = high;
  };
  parallel_chunks(view.num_points(), kPointChunk, num_threads, bound, progress);
  double lowest = kPi / 2.0;
  double highest = -kPi / 2.0;
  for (std::int64_t c = 0; c < chunks; ++c) {
    lowest = std::min(lowest, angle_of_slope(least[c]));
    highest = std::max(highest, angle_of_slope(most[c]));
  }
  return {lowest, highest};
}

// Nearest and farthest range of each cell, as bits of floats, which have the order of the ranges
// because these are positive.
struct CellRanges {
  LargeArray<std::uint32_t> nearest, farthest;
  LargeArray<std::int32_t> cells;  // of each point

  [[nodiscard]] float near(std::int64_t cell) const { return std::bit_cast<float>(nearest[cell]); }
  [[nodiscard]] float far(std::int64_t cell) const { return std::bit_cast<float>(farthest[cell]); }
  [[nodiscard]] bool occupied(std::int64_t cell) const { return farthest[cell] > 0; }
};

template <typename Better>
void improve(std::uint32_t& slot, std::uint32_t value, const Better& better) {
  std::atomic_ref<std::uint32_t> shared(slot);
  std::uint32_t old = shared.load(std::memory_order_relaxed);
  while (better(value, old) &&
         !shared.compare_exchange_weak(old, value, std::memory_order_relaxed)) {
  }
}

CellRanges cell_ranges(const PointsView& view, const CellFinder& finder, int num_threads,
                       const Progress& progress) {
  const std::int64_t size = finder.rows() * finder.columns();
  CellRanges image{LargeArray<std::uint32_t>(size), LargeArray<std::uint32_t>(size),
                   LargeArray<std::int32_t>(view.num_points())};
  const auto clear = [&](std::int64_t begin, std::int64_t end) {
    std::fill(image.nearest.data() + begin, image.nearest.data() + end,
              std::bit_cast<std::uint32_t>(kNothing));
    std::fill(image.farthest.data() + begin, image.farthest.data() + end, 0U);
  };
  const auto enter = [&](std::int64_t begin, std::int64_t end) {
    finder.visit(view, begin, end, [&](std::int64_t i, std::int32_t cell, float range) {
      image.cells[i] = cell;
      if (cell == kNowhere) return;
      const auto bits = std::bit_cast<std::uint32_t>(range);
      improve(image.nearest[cell], bits, std::less<>());
      improve(image.farthest[cell], bits, std::greater<>());
    });
  };
  parallel_chunks(size, 1 << 20, num_threads, clear, progress);
  parallel_chunks(view.num_points(), kPointChunk, num_threads, enter, progress);
  return image;
}

// The printed formula: the sum of |r_p - r_q| over points and their predecessors in the same cell.
std::vector<float> accumulated_gaps(const PointsView& view, const CellFinder& finder,
                                    const Progress& progress) {
  const std::size_t size = finder.rows() * finder.columns();
  std::vector<float> gaps(size);
  std::vector<float> last(size);
  Ticker ticker(progress, 1U << 16);
  finder.visit(view, 0, view.num_points(), [&](std::int64_t, std::int32_t cell, float range) {
    ticker.tick();
    if (cell == kNowhere) return;
    if (last[cell] > 0.0F) gaps[cell] += std::abs(range - last[cell]);
    last[cell] = range;
  });
  return gaps;
}

CellMask gap_mask(const CellRanges& image, const std::vector<float>& gaps, const CellFinder& finder,
                  float min_gap, const Progress& progress, OcclusionResult& result) {
  Ticker ticker(progress, 1U << 20);
  CellMask mask{finder.rows(), finder.columns(), {}};
  mask.cells.resize(mask.rows * mask.columns);
  for (std::int64_t c = 0; c < mask.rows * mask.columns; ++c) {
    ticker.tick();
    if (!image.occupied(c)) continue;
    ++result.occupied_cells;
    const float gap = gaps.empty() ? image.far(c) - image.near(c) : gaps[c];
    if (!(gap > min_gap)) continue;
    mask.cells[c] = 1;
    ++result.multiple_cells;
  }
  return mask;
}

// The smallest cyclic interval of columns that contains all runs.
void span_columns(std::vector<const MarkedRun*> runs, std::int64_t columns,
                  OcclusionComponent& component) {
  std::ranges::sort(runs, {}, &MarkedRun::first);
  std::int64_t reached = runs.front()->last, widest = 0;  // widest gap between runs
  component.first_column = runs.front()->first;
  for (const MarkedRun* run : runs) {
    if (run->first - reached > widest) {
      widest = run->first - reached;
      component.first_column = run->first;
      component.last_column = reached;
    }
    reached = std::max<std::int64_t>(reached, run->last);
  }
  if (runs.front()->first + columns - reached < widest) return;
  component.first_column = runs.front()->first;
  component.last_column = reached;
}

// `marked`: the cells with a gap; the component may have others, which were closed in.
OcclusionComponent measure(const std::vector<const MarkedRun*>& runs, const CellRanges& image,
                           const CellMask& marked, const CellFinder& finder, const ScanGrid& grid) {
  OcclusionComponent component;
  component.first_row = finder.first_row() + runs.front()->row;
  component.last_row = finder.first_row() + runs.back()->row;
  std::vector<float> ranges;
  for (const MarkedRun* run : runs) {
    const double level = sin_cos(finder.elevation_of(run->row)).cos;
    const std::int64_t width = run->last - run->first + 1;
    component.cells += width;
    component.solid_angle +=
        static_cast<double>(width) * grid.azimuth_step * grid.elevation_step * std::max(level, 0.0);
    for (std::int64_t c = run->first; c <= run->last; ++c) {
      const std::int64_t cell = run->row * finder.columns() + c;
      if (marked.cells[cell] != 0) ranges.push_back(image.near(cell));
    }
  }
  if (!ranges.empty()) component.range = median(std::span(ranges));
  component.area = component.solid_angle * component.range * component.range;
  span_columns(runs, finder.columns(), component);
  return component;
}

// Selects the components of at least A_th (`min_area`), `min_cells` and at most `max_range`, the
// largest area first. Returns the component of each cell, -1 for others.
std::vector<std::int32_t> select_components(const CellMask& mask, const CellMask& marked,
                                            const CellRanges& image, const CellFinder& finder,
                                            const OcclusionOptions& options,
                                            const Progress& progress, OcclusionResult& result) {
  ConnectedRuns connected;
  const auto& runs = connected.find(mask.cells.data(), mask.rows, mask.columns, true);
  std::vector<std::vector<const MarkedRun*>> by_component(connected.num_components());
  for (const MarkedRun& run : runs) by_component[run.component].push_back(&run);

  struct Found {
    OcclusionComponent component;
    std::int32_t number;
  };
  std::vector<Found> found;
  Ticker ticker(progress, 1U << 6);
  for (std::int32_t n = 0; n < connected.num_components(); ++n) {
    ticker.tick();
    const OcclusionComponent component =
        measure(by_component[n], image, marked, finder, options.grid);
    if (component.cells >= options.min_cells && component.area >= options.min_area &&
        component.range <= options.max_range) {
      found.push_back({component, n});
    }
  }
  std::stable_sort(found.begin(), found.end(), [](const Found& a, const Found& b) {
    return a.component.area > b.component.area;
  });
  std::vector<std::int32_t> cell_component;
  if (found.empty()) return cell_component;
  cell_component.assign(mask.cells.size(), -1);
  for (const Found& entry : found) {
    const auto index = static_cast<std::int32_t>(result.components.size());
    for (const MarkedRun* run : by_component[entry.number]) {
      std::fill_n(cell_component.begin() + run->row * mask.columns + run->first,
                  run->last - run->first + 1, index);
    }
    result.components.push_back(entry.component);
  }
  return cell_component;
}

// Adds the points in front of the farthest point of their cell. Accumulated gaps may exceed
// `min_gap` where no point is so far in front; then those count that are nearer than the middle.
void suspect_points(const PointsView& view, const CellRanges& image, const CellMask& marked,
                    const std::vector<std::int32_t>& cell_component,
                    const OcclusionOptions& options, const Progress& progress,
                    OcclusionResult& result) {
  Ticker ticker(progress, 1U << 16);
  const auto min_gap = static_cast<float>(options.min_gap);
  std::vector<std::vector<std::int32_t>> rows(result.components.size());
  for (std::int64_t i = 0; i < view.num_points(); ++i) {
    ticker.tick();
    const std::int32_t cell = image.cells[i];
    if (cell == kNowhere || cell_component[cell] < 0) continue;
    if (marked.cells[cell] == 0) continue;
    const float half = 0.5F * (image.far(cell) - image.near(cell));
    const float in_front = options.accumulate ? std::min(min_gap, half) : min_gap;
    const Eigen::Vector3d p = view.points.row(i).transpose().cast<double>() - options.origin;
    if (!(image.far(cell) - p.norm() > in_front)) continue;
    rows[cell_component[cell]].push_back(static_cast<std::int32_t>(i));
    result.suspected.push_back(static_cast<std::int32_t>(i));
    result.suspected_component.push_back(cell_component[cell]);
  }
  for (std::size_t n = 0; n < rows.size(); ++n) {
    result.components[n].box = box_around(view, rows[n]);
  }
}

// The interval of rows with points.
std::pair<std::int64_t, std::int64_t> occupied_rows(const CellRanges& image,
                                                    const CellFinder& finder) {
  const std::uint32_t* begin = image.farthest.data();
  const std::uint32_t* end = begin + image.farthest.size();
  const auto is_set = [](std::uint32_t bits) { return bits > 0; };
  const std::uint32_t* first = std::find_if(begin, end, is_set);
  if (first == end) return {0, 0};
  const std::uint32_t* last = end;
  while (!is_set(*(last - 1))) --last;
  return {(first - begin) / finder.columns(), (last - 1 - begin) / finder.columns() + 1};
}

std::vector<std::uint8_t> cropped(const CellMask& mask, std::int64_t first, std::int64_t last) {
  return {mask.cells.begin() + first * mask.columns, mask.cells.begin() + last * mask.columns};
}

}  // namespace

OcclusionResult occlusion_consistency(const PointsView& view, const OcclusionOptions& options,
                                      const Progress& progress) {
  check_options(options);
  check_points_everywhere(view, options.num_threads, progress);
  CellFinder finder(options);
  const auto [lowest, highest] = elevations(view, options.origin, options.num_threads, progress);
  if (lowest <= highest) finder.crop(lowest, highest);
  const CellRanges image = cell_ranges(view, finder, options.num_threads, progress);
  std::vector<float> gaps;
  if (options.accumulate) gaps = accumulated_gaps(view, finder, progress);
  OcclusionResult result;
  const CellMask raw =
      gap_mask(image, gaps, finder, static_cast<float>(options.min_gap), progress, result);
  const CellMask closed = rank_filter(rank_filter(raw, 1, progress), 9, progress);
  const CellMask mask = rank_filter(closed, 5, progress);
  const std::vector<std::int32_t> cell_component =
      select_components(mask, raw, image, finder, options, progress, result);
  if (!result.components.empty()) {
    suspect_points(view, image, raw, cell_component, options, progress, result);
  }
  const auto [first, last] = occupied_rows(image, finder);
  result.first_row = finder.first_row() + first;
  result.rows = last - first;
  result.columns = finder.columns();
  result.mask = cropped(mask, first, last);
  result.raw_mask = cropped(raw, first, last);
  return result;
}

}  // namespace manip3d
