#include "geometry/angular_grid.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <bit>
#include <cmath>
#include <span>
#include <utility>

#include "geometry/median.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

constexpr double kTile = 4.0 * kDegree;
constexpr std::int64_t kTilesAround = 90;
constexpr double kOtherAngle = 2.0 * kDegree;  // extent of a window in the other angle
constexpr PhaseWindow kNarrowest = {};

// Cosine and sine of an angle in turns, to 1e-6.
SinCos wave_of(double turns) {
  const double quarters = std::nearbyint(4.0 * turns);
  const double x = (turns - 0.25 * quarters) * (2.0 * kPi);
  const double s = x * x;
  const double sine = x * (1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0)));
  const double cosine = 1.0 - s / 2.0 * (1.0 - s / 12.0 * (1.0 - s / 30.0));
  const auto quadrant = static_cast<std::int64_t>(quarters) & 3;
  if (quadrant == 0) return {sine, cosine};
  if (quadrant == 1) return {cosine, -sine};
  if (quadrant == 2) return {-sine, -cosine};
  return {-cosine, sine};
}

}  // namespace

void PolarPoints::see(const std::vector<Vector3d>& points, const Vector3d& position) {
  const std::size_t count = points.size();
  rays.resize(count), azimuth.resize(count), elevation.resize(count);
  range.resize(count), rho.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    const Vector3d ray = points[i] - position;
    rays[i] = ray;
    rho[i] = std::max(1e-6, std::sqrt(ray.x() * ray.x() + ray.y() * ray.y()));
    range[i] = std::sqrt(rho[i] * rho[i] + ray.z() * ray.z());
    azimuth[i] = arc_tangent(ray.y(), ray.x());
    elevation[i] = arc_tangent(ray.z(), rho[i]);
  }
}

// --- Phases --------------------------------------------------------------------------------------

void WindowedPhases::gather(const PolarPoints& points, GridAngle angle, double step,
                            const PhaseWindow& window) {
  const double width = static_cast<double>(window.columns) * step;
  sums_.assign(number_windows(points, angle, width, window.parts), {});
  const std::vector<double>& own = angle == GridAngle::kAzimuth ? points.azimuth : points.elevation;
  waves_.resize(own.size());
  for (std::size_t i = 0; i < own.size(); ++i) {
    waves_[i] = manip3d::wave_of(own[i] / step);
    Sum& sum = sums_[windows_[i]];
    sum.cosine += waves_[i].cos;
    sum.sine += waves_[i].sin;
    sum.count += 1.0;
  }
}

// Numbers the windows that contain points, and stores the window of each point. Returns the number
// of windows.
std::int32_t WindowedPhases::number_windows(const PolarPoints& points, GridAngle angle,
                                            double width, int parts) {
  constexpr std::uint64_t kEmpty = ~std::uint64_t{0};
  const bool is_azimuth = angle == GridAngle::kAzimuth;
  const std::vector<double>& own = is_azimuth ? points.azimuth : points.elevation;
  const std::vector<double>& other = is_azimuth ? points.elevation : points.azimuth;
  const std::size_t count = own.size();
  const std::size_t size = std::bit_ceil(2 * count + 1);
  keys_.assign(size, kEmpty);
  numbers_.resize(size);
  windows_.resize(count);
  std::int32_t found = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto across = static_cast<std::uint64_t>((own[i] + kPi) / width);
    const auto up = static_cast<std::uint64_t>((other[i] + kPi) / kOtherAngle);
    // The exponent of a float and its first mantissa bits are approximately a logarithm.
    const auto far =
        std::bit_cast<std::uint32_t>(static_cast<float>(points.range[i])) >> (23 - parts);
    const std::uint64_t key = (across * 1024 + up) * (std::uint64_t{1} << 32) + far;
    std::size_t slot = mix(key) & (size - 1);
    while (keys_[slot] != kEmpty && keys_[slot] != key) slot = (slot + 1) & (size - 1);
    if (keys_[slot] == kEmpty) keys_[slot] = key, numbers_[slot] = found++;
    windows_[i] = numbers_[slot];
  }
  return found;
}

double WindowedPhases::coherence() const {
  double agreement = 0.0;
  double pairs = 0.0;
  for (const Sum& sum : sums_) agreement += sum.agreement(), pairs += sum.pairs();
  return pairs > 0.0 ? agreement / pairs : 0.0;
}

// --- The points and the position -----------------------------------------------------------------

AngularGrid::AngularGrid(std::vector<Vector3d> points, const Vector3d& position,
                         const Progress& progress)
    : points_(std::move(points)), position_(position), ticker_(progress, 1) {
  polar_.see(points_, position_);
}

void AngularGrid::move_to(const Vector3d& position) {
  position_ = position;
  polar_.see(points_, position_);
}

double AngularGrid::median_range() const {
  std::vector<double> ranges(polar_.range);
  return median(std::span(ranges));
}

std::int64_t AngularGrid::tile_of(std::size_t point) const {
  const auto part = [](double angle) {
    return std::min(kTilesAround - 1, static_cast<std::int64_t>((angle + kPi) / kTile));
  };
  return part(polar_.elevation[point]) * kTilesAround + part(polar_.azimuth[point]);
}

void AngularGrid::keep_tiles(std::int64_t most, std::uint64_t draw) {
  const double share = static_cast<double>(most) / static_cast<double>(points_.size());
  if (share >= 1.0) return;
  std::vector<Vector3d> kept;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (uniform(draw, tile_of(i)) < share) kept.push_back(points_[i]);
  }
  points_ = std::move(kept);
  polar_.see(points_, position_);
}

double AngularGrid::cell_area() const {
  std::vector<std::uint8_t> seen(360 * 181);
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const auto row = static_cast<std::size_t>((polar_.elevation[i] + kPi / 2.0) / kDegree);
    const auto column = static_cast<std::size_t>((polar_.azimuth[i] + kPi) / kDegree);
    seen[std::min<std::size_t>(row, 180) * 360 + std::min<std::size_t>(column, 359)] = 1;
  }
  const auto cells = static_cast<double>(std::count(seen.begin(), seen.end(), 1));
  return cells * kDegree * kDegree / static_cast<double>(points_.size());
}

// --- The combs -----------------------------------------------------------------------------------

const WindowedPhases& AngularGrid::phases(GridAngle angle, double step, const PhaseWindow& window) {
  ticker_.tick();
  phases_.gather(polar_, angle, step, window);
  return phases_;
}

AngleComb AngularGrid::find_comb(GridAngle angle, double shortest, double longest,
                                 AngularGrid* few) {
  // Over eight columns, the phase then drifts by a third of a column.
  constexpr double kRatio = 1.04;
  constexpr double kNearly = 0.8;
  std::vector<AngleComb> tried;
  for (double step = shortest; step <= longest; step *= kRatio) tried.push_back({step, 1.0});
  if (few != nullptr) few->rule_out(angle, tried);
  double best = 0.0;
  for (AngleComb& comb : tried) {
    if (comb.coherence == 0.0) continue;
    comb.coherence = phases(angle, comb.step, kNarrowest).coherence();
    best = std::max(best, comb.coherence);
  }
  std::size_t last = tried.size() - 1;
  while (last > 0 && !(tried[last].coherence >= kNearly * best)) --last;
  const std::size_t peak = last;
  for (std::size_t i = peak - std::min<std::size_t>(peak, 3); i < peak; ++i) {
    if (tried[i].coherence > tried[last].coherence) last = i;
  }
  return tried[last];
}

// Sets the coherence of steps to 0 whose coherence is less than half of the best.
void AngularGrid::rule_out(GridAngle angle, std::vector<AngleComb>& steps) {
  constexpr double kHalf = 0.5;
  constexpr double kNoise = 0.01;  // three standard deviations for 8000 points
  double best = 0.0;
  for (AngleComb& comb : steps) {
    comb.coherence = phases(angle, comb.step, kNarrowest).coherence();
    best = std::max(best, comb.coherence);
  }
  const double least = std::max(kHalf * best, kFaintCoherence) - kNoise;
  for (AngleComb& comb : steps) {
    if (!(comb.coherence >= least)) comb.coherence = 0.0;
  }
}

void AngularGrid::find_rows(double cell_area, double range) {
  constexpr int kHeights = 4;        // heights on either side
  constexpr double kHeight = 0.025;  // share of the range
  constexpr double kUnsure = 1.6;    // factor on the distance, because some rays have no return
  const Vector3d start = position_;
  const double expected = std::clamp(cell_area / azimuth.step, kFinest, kCoarsest);
  AngleComb best;
  Vector3d place = start;
  for (int k = -kHeights; k <= kHeights; ++k) {
    move_to({start.x(), start.y(), start.z() + k * kHeight * range});
    const AngleComb comb = find_comb(GridAngle::kElevation, expected / kUnsure, expected * kUnsure);
    if (comb.coherence > best.coherence) best = comb, place = position_;
  }
  move_to(place);
  elevation = best;
}

double AngularGrid::judged(GridAngle angle, const PhaseWindow& window) {
  const double step = comb(angle).step;
  return step > 0.0 ? phases(angle, step, window).coherence() : 0.0;
}

// --- Improvement ---------------------------------------------------------------------------------

double AngularGrid::improve(const PhaseWindow& window, bool fixed) {
  constexpr double kLargestChange = 0.02;  // share of a step, per iteration
  Matrix5 normal = Matrix5::Zero();
  Vector5 gradient = Vector5::Zero();
  for (const GridAngle angle : kGridAngles) {
    AngleComb& found = comb(angle);
    if (found.step == 0.0) continue;
    const WindowedPhases& now = phases(angle, found.step, window);
    found.coherence = now.coherence();
    const double weight = std::max(found.coherence, 0.0) * std::max(found.coherence, 0.0);
    if (weight != 0.0) add_differences(now, angle, found.step, weight, normal, gradient);
  }
  if (fixed) {
    normal.topRows<3>().setZero();
    normal.leftCols<3>().setZero();
    gradient.head<3>().setZero();
  }
  // Damping, so that unknowns that no phase depends on do not move.
  normal.diagonal().array() += 1e-9 * normal.trace() + 1e-12;
  const Vector5 change = normal.ldlt().solve(gradient);
  azimuth.step *= 1.0 + std::clamp(change[3], -kLargestChange, kLargestChange);
  elevation.step *= 1.0 + std::clamp(change[4], -kLargestChange, kLargestChange);
  move_to(position_ + change.head<3>());
  return change.head<3>().norm();
}

// Derivatives of a point's phase by the five unknowns, radians.
AngularGrid::Vector5 AngularGrid::slope_of(std::size_t point, GridAngle angle, double step) const {
  Vector5 slope = Vector5::Zero();
  const Vector3d& ray = polar_.rays[point];
  const double rho = polar_.rho[point];
  const double squared = polar_.range[point] * polar_.range[point];
  if (angle == GridAngle::kAzimuth) {
    slope << ray.y() / (rho * rho), -ray.x() / (rho * rho), 0.0, -polar_.azimuth[point], 0.0;
  } else {
    slope << ray.z() * ray.x() / (rho * squared), ray.z() * ray.y() / (rho * squared),
        -rho / squared, 0.0, -polar_.elevation[point];
  }
  return Vector5((2.0 * kPi / step) * slope);
}

// Adds the normal equations of one angle, which minimize the differences of phases from the means
// of their windows.
void AngularGrid::add_differences(const WindowedPhases& phases, GridAngle angle, double step,
                                  double weight, Matrix5& normal, Vector5& gradient) const {
  constexpr double kSteepest = 1e3;  // radians of phase per metre; it is larger beside the axis
  std::vector<Vector5> slopes(phases.num_windows(), Vector5::Zero());
  for (std::size_t i = 0; i < points_.size(); ++i) {
    slopes[phases.window_of(i)] += slope_of(i, angle, step);
  }
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const WindowedPhases::Sum& sum = phases.sum(phases.window_of(i));
    if (!(sum.count > 1.0)) continue;
    // Sine and cosine of the difference from the mean of the window.
    const double size = std::sqrt(sum.cosine * sum.cosine + sum.sine * sum.sine) + 1e-12;
    const SinCos own = phases.wave_of(i);
    const double cosine = (own.cos * sum.cosine + own.sin * sum.sine) / size;
    const double sine = (own.sin * sum.cosine - own.cos * sum.sine) / size;
    if (!(cosine > 0.0)) continue;
    const Vector5 slope = slope_of(i, angle, step) - slopes[phases.window_of(i)] / sum.count;
    if (!(slope.cwiseAbs().maxCoeff() < kSteepest)) continue;
    normal += (weight * cosine) * slope * slope.transpose();
    gradient -= (weight * cosine * sine) * slope;
  }
}

double AngularGrid::explained(GridAngle angle, const PhaseWindow& window) {
  constexpr double kMinPairs = 20.0;
  constexpr std::size_t kMinTiles = 10;
  const WindowedPhases& now = phases(angle, comb(angle).step, window);
  std::vector<std::int64_t> tile(now.num_windows());
  for (std::size_t i = 0; i < points_.size(); ++i) tile[now.window_of(i)] = tile_of(i);
  std::vector<double> agreement(kTilesAround * kTilesAround);
  std::vector<double> pairs(agreement.size());
  for (std::size_t w = 0; w < now.num_windows(); ++w) {
    agreement[tile[w]] += now.sum(w).agreement();
    pairs[tile[w]] += now.sum(w).pairs();
  }
  std::vector<double> shares;
  for (std::size_t t = 0; t < pairs.size(); ++t) {
    if (pairs[t] < kMinPairs) continue;
    shares.push_back(std::sqrt(std::max(0.0, agreement[t] / pairs[t])));
  }
  if (shares.size() < kMinTiles) return 0.0;  // too small a view for a decision
  std::sort(shares.begin(), shares.end());
  const double usual = shares[shares.size() * 4 / 5];
  double sum = 0.0;
  for (const double share : shares) sum += std::min(1.0, share / std::max(usual, 1e-9));
  return sum / static_cast<double>(shares.size());
}

}  // namespace manip3d
