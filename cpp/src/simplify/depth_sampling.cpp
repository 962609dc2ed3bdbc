#include "manip3d/simplify/depth_sampling.hpp"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "geometry/dart_board.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

void check(const PointGridView& grid, std::int64_t target_points) {
  check_point_grid(grid);
  if (target_points < 1) {
    throw InputError("target_points: expected >= 1, got " + std::to_string(target_points));
  }
}

bool is_valid(const PointGridView& grid, std::int64_t row, std::int64_t col) {
  return grid.valid[row * grid.cols + col] != 0;
}

Eigen::Vector3f point_at(const PointGridView& grid, std::int64_t row, std::int64_t col) {
  return Eigen::Map<const Eigen::Vector3f>(grid.points + 3 * (row * grid.cols + col));
}

Pixel pixel_at(std::int64_t row, std::int64_t col) {
  return {static_cast<std::int32_t>(col), static_cast<std::int32_t>(row)};
}

std::vector<Pixel> valid_pixels(const PointGridView& grid) {
  std::vector<Pixel> pixels;
  for (std::int64_t row = 0; row < grid.rows; ++row) {
    for (std::int64_t col = 0; col < grid.cols; ++col) {
      if (is_valid(grid, row, col)) pixels.push_back(pixel_at(row, col));
    }
  }
  return pixels;
}

/// Chooses `count` of the pixels, evenly spread over their order.
std::vector<Pixel> spread(const std::vector<Pixel>& pixels, std::int64_t count) {
  const auto size = static_cast<std::int64_t>(pixels.size());
  std::vector<Pixel> kept;
  for (std::int64_t i = 0; i < std::min(count, size); ++i) {
    kept.push_back(pixels[i * size / std::min(count, size)]);
  }
  return kept;
}

// --- Uniform -----------------------------------------------------------------------------------

/// Rows or columns of a lattice: the centres of intervals of length `spacing`, or the middle of the
/// image if it is too narrow for one.
std::vector<std::int64_t> lattice_lines(std::int64_t size, double spacing) {
  std::vector<std::int64_t> lines;
  for (double at = 0.5 * spacing; at < static_cast<double>(size); at += spacing) {
    lines.push_back(static_cast<std::int64_t>(at));
  }
  if (lines.empty()) lines.push_back(size / 2);
  return lines;
}

std::vector<Pixel> on_lattice(const PointGridView& grid, double spacing) {
  const std::vector<std::int64_t> cols = lattice_lines(grid.cols, spacing);
  std::vector<Pixel> pixels;
  for (const std::int64_t row : lattice_lines(grid.rows, spacing)) {
    for (const std::int64_t col : cols) {
      if (is_valid(grid, row, col)) pixels.push_back(pixel_at(row, col));
    }
  }
  return pixels;
}

/// The first lattice with a larger spacing that has 1 to `target_points` valid pixels. If there is
/// none, because pixels of any wide lattice are not measured, the valid pixels, evenly spread.
std::vector<Pixel> on_wider_lattice(const PointGridView& grid, double spacing,
                                    std::int64_t target_points) {
  constexpr double kWider = 1.01;
  const auto largest = static_cast<double>(std::max(grid.rows, grid.cols));
  for (; spacing < 2.0 * kWider * largest; spacing *= kWider) {
    std::vector<Pixel> pixels = on_lattice(grid, spacing);
    if (!pixels.empty() && std::ssize(pixels) <= target_points) return pixels;
  }
  return spread(valid_pixels(grid), target_points);
}

// --- Scale space -------------------------------------------------------------------------------

/// A run of valid pixels in one row, and the distance of its points from the medial axis.
struct Run {
  std::int64_t row, first;
  std::vector<double> radius;
};

std::vector<Run> runs_of_row(const PointGridView& grid, std::int64_t row) {
  Eigen::AlignedBox3f extent;
  for (std::int64_t col = 0; col < grid.cols; ++col) {
    if (is_valid(grid, row, col)) extent.extend(point_at(grid, row, col));
  }
  std::vector<Run> runs;
  if (extent.isEmpty()) return runs;
  const Eigen::Vector3f axis = extent.center();
  bool inside = false;
  for (std::int64_t col = 0; col < grid.cols; ++col) {
    const bool valid = is_valid(grid, row, col);
    if (valid && !inside) runs.push_back({row, col, {}});
    if (valid) {
      const Eigen::Vector3d arm = (point_at(grid, row, col) - axis).cast<double>();
      runs.back().radius.push_back(std::sqrt(arm.x() * arm.x() + arm.z() * arm.z()));
    }
    inside = valid;
  }
  return runs;
}

std::vector<Run> medial_runs(const PointGridView& grid) {
  std::vector<Run> runs;
  for (std::int64_t row = 0; row < grid.rows; ++row) {
    for (Run& run : runs_of_row(grid, row)) runs.push_back(std::move(run));
  }
  return runs;
}

/// Half of a symmetric kernel: the second difference of a Gaussian whose value at k is
/// `ratio`^(k^2). Powers are computed by multiplication, so that crossings are the same on every
/// processor.
std::vector<double> laplacian_of_gaussian(double ratio) {
  constexpr double kCut = 1e-5;
  std::vector<double> gaussian{1.0};
  for (double step = ratio; gaussian.back() > kCut; step *= ratio * ratio) {
    gaussian.push_back(gaussian.back() * step);
  }
  gaussian.insert(gaussian.end(), {0.0, 0.0});
  std::vector<double> kernel{2.0 * (gaussian[1] - gaussian[0])};
  for (std::size_t k = 1; k + 1 < gaussian.size(); ++k) {
    kernel.push_back(gaussian[k - 1] - 2.0 * gaussian[k] + gaussian[k + 1]);
  }
  return kernel;
}

/// Filters the values of a run; beyond its ends they are continued as constants.
std::vector<double> filtered(const std::vector<double>& values, const std::vector<double>& kernel) {
  const auto n = static_cast<std::int64_t>(values.size());
  const auto at = [&](std::int64_t i) { return values[std::clamp<std::int64_t>(i, 0, n - 1)]; };
  std::vector<double> result(values.size());
  for (std::int64_t i = 0; i < n; ++i) {
    double sum = kernel[0] * at(i);
    for (std::int64_t k = 1; k < static_cast<std::int64_t>(kernel.size()); ++k) {
      sum += kernel[k] * (at(i - k) + at(i + k));
    }
    result[i] = sum;
  }
  return result;
}

std::vector<Pixel> zero_crossings(const std::vector<Run>& runs, double ratio) {
  // Share of the radius; on flat parts, signs are rounding noise.
  constexpr double kRounding = 1e-9;
  const std::vector<double> kernel = laplacian_of_gaussian(ratio);
  std::vector<Pixel> pixels;
  for (const Run& run : runs) {
    const std::vector<double> response = filtered(run.radius, kernel);
    for (std::size_t i = 0; i + 1 < response.size(); ++i) {
      const double left = response[i], right = response[i + 1];
      const bool crosses = (left < 0.0) != (right < 0.0);
      if (!crosses || !(std::abs(left - right) > kRounding * run.radius[i])) continue;
      const std::size_t nearer = std::abs(left) <= std::abs(right) ? i : i + 1;
      const Pixel pixel = pixel_at(run.row, run.first + static_cast<std::int64_t>(nearer));
      if (pixels.empty() || !(pixels.back() == pixel)) pixels.push_back(pixel);
    }
  }
  return pixels;
}

}  // namespace

std::vector<Pixel> sample_uniform(const PointGridView& grid, std::int64_t target_points) {
  check(grid, target_points);
  const auto num_valid = static_cast<double>(valid_pixels(grid).size());
  if (num_valid <= static_cast<double>(target_points)) return valid_pixels(grid);
  // The number decreases with the spacing, but not monotonically. Coarse steps are tried first,
  // then fine ones.
  constexpr int kTries = 40;
  double spacing = std::sqrt(num_valid / static_cast<double>(target_points));
  std::vector<Pixel> best;
  for (const double step : {1e-2, 1e-3}) {
    const double middle = spacing;
    for (int i = -kTries / 2; i <= kTries / 2; ++i) {
      const double tried = middle * (1.0 + step * i);
      std::vector<Pixel> pixels = on_lattice(grid, tried);
      const auto count = static_cast<std::int64_t>(pixels.size());
      if (count > target_points || pixels.size() <= best.size()) continue;
      best = std::move(pixels);
      spacing = tried;
    }
  }
  return best.empty() ? on_wider_lattice(grid, spacing, target_points) : best;
}

PoissonDiskSample sample_poisson_disk(const PointGridView& grid, std::int64_t target_points,
                                      std::uint64_t seed) {
  check(grid, target_points);
  const std::vector<Pixel> pixels = valid_pixels(grid);
  if (std::ssize(pixels) <= target_points) return {pixels, 0.0};
  Points points(std::ssize(pixels), 3);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    points.row(i) = point_at(grid, pixels[i].v, pixels[i].u).transpose();
  }
  Eigen::AlignedBox3f box;
  for (const auto& point : points.rowwise()) box.extend(point.transpose());
  if (box.min() == box.max()) return {{pixels.front()}, 0.0};
  DartBoard board(view_of(points), seed, box.min().cast<double>(), {});
  std::vector<std::int32_t> best;
  double best_radius = 0.0;
  // With the diagonal as radius only one or two points are kept; with a millionth of it nearly all.
  double high = 1.01 * box.diagonal().cast<double>().norm();
  double low = 1e-6 * high;
  double radius = high / std::sqrt(static_cast<double>(target_points));
  constexpr int kMaxSteps = 40;
  for (int step = 0; step < kMaxSteps && low < high; ++step) {
    std::vector<std::int32_t> kept = board.sample(radius);
    const std::int64_t count = std::ssize(kept);
    if (count <= target_points && kept.size() > best.size()) {
      best = std::move(kept);
      best_radius = radius;
    }
    if (count <= target_points && 100 * count >= 99 * target_points) break;
    (count > target_points ? low : high) = radius;
    // The number of disks is inversely proportional to the square of the radius.
    const double guess = radius * std::sqrt(static_cast<double>(count) /
                                            (0.995 * static_cast<double>(target_points)));
    radius = low < guess && guess < high ? guess : 0.5 * (low + high);
  }
  PoissonDiskSample sample{{}, best_radius};
  for (const std::int32_t i : best) sample.pixels.push_back(pixels[i]);
  return sample;
}

ScaleSpaceSample sample_scale_space(const PointGridView& grid, std::int64_t target_points) {
  check(grid, target_points);
  const std::vector<Run> runs = medial_runs(grid);
  // Approximates exp(-x) for x = 1 / (2 sigma^2) by a fraction that is the same on every processor.
  const auto ratio_of = [](double sigma) {
    const double x = 1.0 / (2.0 * sigma * sigma);
    return 1.0 / (1.0 + x + 0.5 * x * x);
  };
  double low = 0.5;
  double high = std::max(1.0, static_cast<double>(grid.cols) / 8.0);
  ScaleSpaceSample best;
  constexpr int kSteps = 24;
  for (int step = 0; step < kSteps; ++step) {
    const double sigma = step == 0 ? low : 0.5 * (low + high);
    std::vector<Pixel> pixels = zero_crossings(runs, ratio_of(sigma));
    const auto count = static_cast<std::int64_t>(pixels.size());
    if (count <= target_points && pixels.size() > best.pixels.size()) {
      best = {std::move(pixels), sigma};
    }
    if (count <= target_points && (step == 0 || 100 * count >= 99 * target_points)) break;
    if (step > 0) (count > target_points ? low : high) = sigma;
  }
  if (best.pixels.empty())
    best = {spread(zero_crossings(runs, ratio_of(high)), target_points), high};
  return best;
}

}  // namespace manip3d
