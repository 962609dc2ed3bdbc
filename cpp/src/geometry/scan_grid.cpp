#include "manip3d/geometry/scan_grid.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "geometry/constants.hpp"
#include "geometry/directions.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kSampleBlocks = 8192;       // blocks of 256 points
constexpr std::int64_t kVeryFewPoints = 60'000;    // too few for 1-degree cells
constexpr std::int64_t kFewForFineBins = 500'000;  // too few for fine bins
constexpr double kFineBin = 0.002 * kDegree;
constexpr double kCoarseBin = 0.01 * kDegree;
// The result for a finer grid is a multiple of its step; terrestrial scanners have steps down to
// 0.0024 degrees.
constexpr double kShortestPeriod = 0.016 * kDegree;
constexpr double kLongestPeriod = 2.0 * kDegree;
constexpr double kSmoothing = 2.0 * kDegree;  // variations over more than this come from the scene
// Multiple of the local mean; a higher count is a spike, which appears where coordinates were
// rounded, and is cut to this.
constexpr double kSpike = 8.0;
// Share of the highest peak, because multiples of the period have peaks of equal height.
constexpr double kFundamental = 0.7;
// Share of the highest peak; the autocorrelation is lower between teeth.
constexpr double kValley = 0.5;
constexpr double kWeakestComb = 0.45;  // below, periods come from the scene
constexpr std::int64_t kRefinedPeriods = 256;

struct Histograms {
  double bin = kFineBin;  // radians
  std::vector<std::int64_t> azimuth;
  std::vector<std::int64_t> elevation;
  std::int64_t cell = 1;  // degrees
  std::vector<std::uint8_t> seen = std::vector<std::uint8_t>(360 * 180);
};

std::int64_t clamped_bin(double value, double width, std::int64_t bins) {
  return std::clamp(static_cast<std::int64_t>(value / width), std::int64_t{0}, bins - 1);
}

Histograms sample_angles(const PointsView& view, const Eigen::Vector3d& origin) {
  Histograms histograms;
  if (view.num_points() < kFewForFineBins) histograms.bin = kCoarseBin;
  if (view.num_points() < kVeryFewPoints) histograms.cell = 5;
  const double side = static_cast<double>(histograms.cell) * kDegree;
  const auto half_turn = static_cast<std::int64_t>(kPi / histograms.bin + 0.5);
  histograms.azimuth.resize(2 * half_turn);
  histograms.elevation.resize(half_turn);
  Directions directions;
  const std::int64_t blocks = (view.num_points() + Directions::kBlock - 1) / Directions::kBlock;
  const std::int64_t every = std::max<std::int64_t>(1, blocks / kSampleBlocks);
  for (std::int64_t b = 0; b < blocks; b += every) {
    // A random one of the next `every` blocks, to avoid beats with the scanner's own order.
    const std::int64_t block =
        std::min(blocks - 1, b + static_cast<std::int64_t>(random_bits(0, b) % every));
    const std::int64_t begin = block * Directions::kBlock;
    const std::int64_t size = std::min(Directions::kBlock, view.num_points() - begin);
    directions.compute(view.points.data() + 3 * begin, 3, size, origin);
    for (std::int64_t i = 0; i < size; ++i) {
      const double azimuth = directions.azimuth[i] + kPi;
      const double elevation = directions.elevation[i] + kPi / 2.0;
      if (!(directions.range[i] > 0.0F)) continue;  // it has no direction
      ++histograms.azimuth[clamped_bin(azimuth, histograms.bin, 2 * half_turn)];
      ++histograms.elevation[clamped_bin(elevation, histograms.bin, half_turn)];
      histograms.seen[clamped_bin(elevation, side, 180) * 360 + clamped_bin(azimuth, side, 360)] =
          1;
    }
  }
  return histograms;
}

// Subtracts from each value the mean of those around it.
std::vector<double> high_passed(const std::vector<double>& values, std::int64_t half,
                                std::vector<double>& means) {
  const auto size = static_cast<std::int64_t>(values.size());
  std::vector<double> sums(values.size() + 1);
  for (std::int64_t i = 0; i < size; ++i) sums[i + 1] = sums[i] + values[i];
  std::vector<double> rest(values.size());
  means.resize(values.size());
  for (std::int64_t i = 0; i < size; ++i) {
    const std::int64_t low = std::max<std::int64_t>(0, i - half);
    const std::int64_t high = std::min(size, i + half);
    means[i] = (sums[high] - sums[low]) / static_cast<double>(high - low);
    rest[i] = values[i] - means[i];
  }
  return rest;
}

// The teeth of a histogram: without slow variations, which come from the scene, and without spikes.
std::vector<float> teeth_of(const std::vector<std::int64_t>& histogram, double bin) {
  const auto half = static_cast<std::int64_t>(kSmoothing / bin / 2.0);
  std::vector<double> values(histogram.begin(), histogram.end());
  std::vector<double> means;
  high_passed(values, half, means);
  for (std::size_t i = 0; i < values.size(); ++i)
    values[i] = std::min(values[i], kSpike * means[i]);
  const std::vector<double> passed = high_passed(values, half, means);
  const std::vector<float> rest(passed.begin(), passed.end());
  // Widens the teeth, so that they overlap although periods are not a whole number of bins.
  std::vector<float> smooth(rest);
  for (std::size_t i = 1; i + 1 < rest.size(); ++i) {
    smooth[i] = 0.25F * rest[i - 1] + 0.5F * rest[i] + 0.25F * rest[i + 1];
  }
  return smooth;
}

// Sum of products of values `lag` apart. Eight partial sums, for SIMD; up to seven products at the
// end are left out.
double autocorrelation(const std::vector<float>& values, std::int64_t lag) {
  std::array<float, 8> sums = {};
  const std::int64_t count = static_cast<std::int64_t>(values.size()) - lag;
  const float* a = values.data();
  const float* b = values.data() + lag;
  for (std::int64_t i = 0; i + 8 <= count; i += 8) {
    for (std::size_t k = 0; k < 8; ++k) sums[k] += a[i + k] * b[i + k];
  }
  double sum = 0.0;
  for (const float part : sums) sum += part;
  return sum;
}

struct Comb {
  double step = 0.0;  // radians
  double strength = 0.0;
};

// The lag near `lag` at which the autocorrelation peaks.
std::int64_t peak_near(const std::vector<float>& values, std::int64_t lag, std::int64_t reach) {
  std::int64_t best = lag;
  double highest = autocorrelation(values, lag);
  for (std::int64_t l = std::max<std::int64_t>(1, lag - reach); l <= lag + reach; ++l) {
    const double height = autocorrelation(values, l);
    if (height > highest) {
      highest = height;
      best = l;
    }
  }
  return best;
}

// The step and strength of the period of a histogram; zeros if it has none.
Comb find_comb(const std::vector<std::int64_t>& histogram, double bin, int num_threads,
               const Progress& progress) {
  const std::vector<float> values = teeth_of(histogram, bin);
  const double energy = autocorrelation(values, 0);
  if (!(energy > 0.0)) return {};
  const auto shortest = std::max<std::int64_t>(2, static_cast<std::int64_t>(kShortestPeriod / bin));
  const auto longest = static_cast<std::int64_t>(kLongestPeriod / bin);
  std::vector<double> heights(longest + 1);
  const auto correlate = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t lag = begin; lag < end; ++lag) heights[lag] = autocorrelation(values, lag);
  };
  parallel_chunks(longest + 1, 16, num_threads, correlate, progress);
  // Skips the width of the teeth first, because every histogram resembles itself at small shifts.
  std::int64_t lag = shortest;
  const double any = *std::max_element(heights.begin() + shortest, heights.end());
  while (lag < longest && heights[lag] > kValley * any) ++lag;
  const double highest = *std::max_element(heights.begin() + lag, heights.end());
  if (!(highest >= kWeakestComb * energy)) return {};
  while (heights[lag] < kFundamental * highest) ++lag;
  while (lag < longest && heights[lag + 1] > heights[lag]) ++lag;
  // Multiples of the period determine it to a fraction of a bin.
  double period = static_cast<double>(lag);
  for (std::int64_t k = 2; k <= kRefinedPeriods; k *= 2) {
    const double multiple = period * static_cast<double>(k);
    if (multiple > 0.25 * static_cast<double>(values.size())) break;
    const auto guess = static_cast<std::int64_t>(multiple + 0.5);
    period = static_cast<double>(peak_near(values, guess, 2)) / static_cast<double>(k);
  }
  return {period * bin, heights[lag] / energy};
}

// Position within the period at which most points are.
double phase_of(const std::vector<std::int64_t>& histogram, double bin, double step, double start) {
  constexpr std::int64_t kParts = 32;
  std::vector<std::int64_t> folded(kParts);
  for (std::size_t i = 0; i < histogram.size(); ++i) {
    const double periods = (static_cast<double>(i) + 0.5) * bin / step;
    const double part = (periods - std::floor(periods)) * static_cast<double>(kParts);
    folded[std::min(kParts - 1, static_cast<std::int64_t>(part))] += histogram[i];
  }
  // Weighted sums of neighbouring parts, with wrap-around; nearer parts have more weight.
  std::int64_t best = 0;
  std::int64_t most = -1;
  for (std::int64_t middle = 0; middle < kParts; ++middle) {
    std::int64_t sum = 0;
    for (std::int64_t k = -4; k <= 4; ++k) {
      sum += (5 - std::abs(k)) * folded[(middle + k + kParts) % kParts];
    }
    if (sum > most) {
      most = sum;
      best = middle;
    }
  }
  return start + (static_cast<double>(best) + 0.5) / static_cast<double>(kParts) * step;
}

}  // namespace

std::int64_t ScanGrid::columns() const {
  return std::max<std::int64_t>(1, static_cast<std::int64_t>(2.0 * kPi / azimuth_step + 0.5));
}

std::int64_t ScanGrid::rows() const { return static_cast<std::int64_t>(kPi / elevation_step) + 2; }

ScanGrid estimate_scan_grid(const PointsView& view, const Eigen::Vector3d& origin, int num_threads,
                            const Progress& progress) {
  check_points_everywhere(view, num_threads, part_of(progress, 0.0, 0.1));
  if (!origin.allFinite()) throw InputError("origin: expected finite numbers");
  const Histograms histograms = sample_angles(view, origin);
  const Comb azimuth =
      find_comb(histograms.azimuth, histograms.bin, num_threads, part_of(progress, 0.1, 0.6));
  const Comb elevation =
      find_comb(histograms.elevation, histograms.bin, num_threads, part_of(progress, 0.6, 1.0));
  const std::int64_t cells = std::count(histograms.seen.begin(), histograms.seen.end(), 1);
  const double side = static_cast<double>(histograms.cell) * kDegree;
  const double area = static_cast<double>(std::max<std::int64_t>(1, cells)) * side * side /
                      static_cast<double>(std::max<std::int64_t>(1, view.num_points()));
  // One point per cell; limited, because there may be hardly any points.
  const auto bounded = [](double step) { return std::clamp(step, 0.02 * kDegree, 10.0 * kDegree); };
  ScanGrid grid;
  grid.azimuth_strength = azimuth.strength;
  grid.elevation_strength = elevation.strength;
  grid.azimuth_step = azimuth.step > 0.0
                          ? azimuth.step
                          : bounded(elevation.step > 0.0 ? area / elevation.step : std::sqrt(area));
  grid.elevation_step = elevation.step > 0.0 ? elevation.step : bounded(area / grid.azimuth_step);
  grid.azimuth_phase = phase_of(histograms.azimuth, histograms.bin, grid.azimuth_step, -kPi);
  grid.elevation_phase =
      phase_of(histograms.elevation, histograms.bin, grid.elevation_step, -kPi / 2.0);
  return grid;
}

}  // namespace manip3d
