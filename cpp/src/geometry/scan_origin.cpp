#include "manip3d/geometry/scan_origin.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <numeric>
#include <span>
#include <vector>

#include "geometry/constants.hpp"
#include "geometry/kd_tree.hpp"
#include "geometry/median.hpp"
#include "geometry/select_rows.hpp"
#include "geometry/small_solvers.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

constexpr std::int64_t kSampled = 400'000;    // points for the density of surfaces
constexpr std::int64_t kTilePoints = 40'000;  // points for the grid, in tiles that stay whole
constexpr std::int64_t kCombPoints = 8'000;   // of these, to rule out most of its steps
constexpr std::int64_t kFewestPoints = 1000;
constexpr double kTile = 4.0 * kDegree;
constexpr double kFaint = 0.03;  // coherence, enough to try: it grows as the position gets better

// --- Points --------------------------------------------------------------------------------------

// Different points with a direction; all of a small scan.
Points sample_points(const PointsView& view) {
  const std::int64_t count = view.num_points();
  const double share =
      static_cast<double>(kSampled) / static_cast<double>(std::max(count, kSampled));
  std::vector<std::array<float, 3>> rows;
  for (std::int64_t i = 0; i < count; ++i) {
    if (share < 1.0 && !(uniform(0, i) < share)) continue;
    const auto p = view.points.row(i);
    if (p.isZero(0.0F)) continue;  // how files say that nothing came back
    rows.push_back({p[0], p[1], p[2]});
  }
  // Some scanners see each direction twice; twins agree on any grid.
  std::sort(rows.begin(), rows.end());
  rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  Points points(static_cast<Eigen::Index>(rows.size()), 3);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    points.row(static_cast<Eigen::Index>(i)) << rows[i][0], rows[i][1], rows[i][2];
  }
  return points;
}

// --- A first position, from the density of surfaces ----------------------------------------------

// log2, to 1e-7, without libm.
double binary_log(double x) {
  int exponent = 0;
  const double m = std::frexp(x, &exponent);  // in [0.5, 1)
  const double t = (m - std::numbers::sqrt2 / 2.0) / (m + std::numbers::sqrt2 / 2.0);
  const double s = t * t;
  const double atanh = t * (1.0 + s * (1.0 / 3.0 + s * (1.0 / 5.0 + s * (1.0 / 7.0 + s / 9.0))));
  return exponent - 0.5 + 2.0 * atanh / std::numbers::ln2;
}

struct Patch {
  Vector3d place;
  Vector3d normal;
  double density = 0.0;  // points a square metre
};

std::vector<Patch> sample_patches(const Points& points, const Progress& progress) {
  constexpr std::int64_t kPatches = 1500;
  constexpr std::size_t kNeighbours = 24;
  constexpr double kFlat = 0.15;  // second extent over first, squared: less is a line
  const PointsView view{{points.data(), points.rows(), 3}};
  const KdTree tree(view, progress);
  KdTree::Neighbours near;
  std::vector<Patch> patches;
  for (std::int64_t k = 0; k < kPatches; ++k) {
    const auto row = static_cast<std::int64_t>(uniform(1, k) * static_cast<double>(points.rows()));
    tree.nearest(row, kNeighbours, near);
    Eigen::Matrix<double, Eigen::Dynamic, 3> around(near.rows.size(), 3);
    for (std::size_t i = 0; i < near.rows.size(); ++i) {
      around.row(static_cast<Eigen::Index>(i)) = points.row(near.rows[i]).cast<double>();
    }
    around.rowwise() -= around.colwise().mean().eval();
    const Eigen::Matrix3d spread = around.transpose() * around;
    const PrincipalAxes axes = principal_axes(spread);
    const Vector3d& extent = axes.spreads;
    const double area = kPi * near.squared_distances.back();
    if (!(area > 0.0 && extent[1] > kFlat * extent[2])) continue;
    patches.push_back({points.row(row).cast<double>().transpose(), axes.directions.col(0),
                       static_cast<double>(near.rows.size()) / area});
  }
  return patches;
}

// Mean absolute deviation, from its median, of log2(points of a patch / points that the grid would
// put there): 0 at the true position, up to noise. A patch of area A at range r, whose normal is
// turned by t from the ray, covers a solid angle of A cos t / r^2; a cell of the grid covers
// step^2 rho / r, with rho the distance from the polar axis. So density r rho / cos t is constant.
double unevenness(std::span<const Patch> patches, const Vector3d& origin, int axis,
                  std::vector<double>& logs, std::vector<double>& scratch) {
  constexpr double kMost = 2.2;      // octaves: a larger deviation counts as this one
  constexpr double kGrazing = 0.03;  // least cosine
  logs.clear();
  for (const Patch& patch : patches) {
    const Vector3d ray = patch.place - origin;
    const double range = ray.norm() + 1e-6;
    const double rho = std::sqrt(std::max(0.0, ray.squaredNorm() - ray[axis] * ray[axis])) + 1e-6;
    const double cosine = std::max(std::abs(patch.normal.dot(ray)) / range, kGrazing);
    logs.push_back(binary_log(patch.density * range * rho / cosine));
  }
  scratch = logs;
  const double middle = median(std::span(scratch));
  double sum = 0.0;
  for (const double value : logs) sum += std::min(std::abs(value - middle), kMost);
  return sum / static_cast<double>(logs.size());
}

// A box around the densest surfaces, which are the nearest.
struct PatchBox {
  Vector3d middle, extent;
};

PatchBox dense_box(const std::vector<Patch>& patches, double smallest) {
  std::vector<double> densities;
  for (const Patch& patch : patches) densities.push_back(patch.density);
  std::sort(densities.begin(), densities.end());
  const double dense = densities[densities.size() * 4 / 5];
  PatchBox box;
  for (int a = 0; a < 3; ++a) {
    std::vector<double> values;
    for (const Patch& patch : patches) {
      if (patch.density >= dense) values.push_back(patch.place[a]);
    }
    std::sort(values.begin(), values.end());
    const double low = values[values.size() / 50];
    const double high = values[values.size() - 1 - values.size() / 50];
    box.middle[a] = 0.5 * (low + high);
    box.extent[a] = high - low;
  }
  box.extent = box.extent.cwiseMax(std::max(0.2 * box.extent.maxCoeff(), smallest));
  return box;
}

// The position that makes the patches most even: the best of a coarse block around the densest
// surfaces, which are the nearest, then by halving steps. A cloud that nobody scanned may fall for
// ever without a minimum, so that each step makes a limited number of sweeps.
Vector3d even_position(const std::vector<Patch>& patches, int axis, const Progress& progress) {
  constexpr int kSide = 9;
  constexpr std::size_t kFewPatches = 200;  // they rule out most places of the block
  constexpr int kLikely = 60;
  constexpr int kStarts = 2;
  constexpr int kSweeps = 16;              // for each size of step
  constexpr double kSmallest = 0.002;      // metres
  constexpr double kSmallestShare = 1e-5;  // or of the extent
  const PatchBox box = dense_box(patches, kSmallest);
  const double smallest = std::max(kSmallest, kSmallestShare * box.extent.maxCoeff());
  std::vector<double> logs;
  std::vector<double> scratch;
  Ticker ticker(progress, 1U << 5);
  const auto cost = [&](const Vector3d& p, std::size_t most) {
    ticker.tick();
    const std::span<const Patch> some(patches.data(), std::min(most, patches.size()));
    return unevenness(some, p, axis, logs, scratch);
  };
  std::vector<std::pair<double, int>> costs;
  const auto place = [&](int index) {  // of a block of 1.5 extents
    const Vector3d cell(index / (kSide * kSide), index / kSide % kSide, index % kSide);
    const Vector3d share = 1.5 * (cell / (kSide - 1.0) - Vector3d::Constant(0.5));
    return Vector3d(box.middle + share.cwiseProduct(box.extent));
  };
  for (int i = 0; i < kSide * kSide * kSide; ++i) {
    costs.emplace_back(cost(place(i), kFewPatches), i);
  }
  std::partial_sort(costs.begin(), costs.begin() + kLikely, costs.end());
  costs.resize(kLikely);
  for (auto& [found, index] : costs) found = cost(place(index), patches.size());
  std::partial_sort(costs.begin(), costs.begin() + kStarts, costs.end());
  Vector3d best = place(costs[0].second);
  double least_of_all = costs[0].first;
  for (int s = 0; s < kStarts; ++s) {
    Vector3d p = place(costs[s].second);
    double least = costs[s].first;
    for (Vector3d step = box.extent / 8.0; step.maxCoeff() > smallest; step /= 2.0) {
      bool better = true;
      for (int sweep = 0; better && sweep < kSweeps; ++sweep) {
        better = false;
        for (int move = 0; move < 6; ++move) {
          Vector3d next = p;
          next[move / 2] += move % 2 == 0 ? step[move / 2] : -step[move / 2];
          const double other = cost(next, patches.size());
          if (other < least) p = next, least = other, better = true;
        }
      }
    }
    if (least < least_of_all) best = p, least_of_all = least;
  }
  return best;
}

// --- The grid ------------------------------------------------------------------------------------

enum class Angle { kAzimuth, kElevation };
constexpr Angle kAngles[] = {Angle::kAzimuth, Angle::kElevation};

// Polar coordinates of the points about a position; the polar axis is the third coordinate.
struct Sight {
  std::vector<Vector3d> rays;
  std::vector<double> azimuth, elevation, range, rho;

  void look(const std::vector<Vector3d>& points, const Vector3d& origin) {
    const std::size_t count = points.size();
    rays.resize(count), azimuth.resize(count), elevation.resize(count);
    range.resize(count), rho.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
      const Vector3d ray = points[i] - origin;
      rays[i] = ray;
      rho[i] = std::max(1e-6, std::sqrt(ray.x() * ray.x() + ray.y() * ray.y()));
      range[i] = std::sqrt(rho[i] * rho[i] + ray.z() * ray.z());
      azimuth[i] = arc_tangent(ray.y(), ray.x());
      elevation[i] = arc_tangent(ray.z(), rho[i]);
    }
  }
};

// Cosine and sine of a number of turns, to 1e-6.
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

// Points whose phases are compared with each other. Within a window the phases of the grid agree
// although the position is somewhat off. It spans `columns` steps of one angle, two degrees of the
// other, and 1 / 2^parts of an octave of range: negative `parts` span several octaves.
struct Window {
  std::int64_t columns = 8;
  int parts = 3;
};
constexpr Window kWindows[] = {{8, 3}, {16, 2}, {32, 1}, {64, 0}, {128, -1}, {256, -2}};
constexpr Window kJudged = {16, 0};
constexpr double kOtherAngle = 2.0 * kDegree;

// Numbers the windows that hold points; windows keep their numbers until the next call.
class Windows {
 public:
  // @returns how many there are; `ids` says which one each point is in.
  std::int64_t number(const std::vector<double>& angle, const std::vector<double>& other,
                      const std::vector<double>& range, double width, int parts,
                      std::vector<std::int32_t>& ids) {
    const std::size_t count = angle.size();
    const std::size_t size = std::bit_ceil(2 * count + 1);
    keys_.assign(size, kEmpty);
    numbers_.resize(size);
    ids.resize(count);
    std::int32_t found = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const auto across = static_cast<std::uint64_t>((angle[i] + kPi) / width);
      const auto up = static_cast<std::uint64_t>((other[i] + kPi) / kOtherAngle);
      // The exponent of a float and its first bits: nearly a logarithm.
      const auto far = std::bit_cast<std::uint32_t>(static_cast<float>(range[i])) >> (23 - parts);
      const std::uint64_t key = (across * 1024 + up) * (std::uint64_t{1} << 32) + far;
      std::size_t slot = mix(key) & (size - 1);
      while (keys_[slot] != kEmpty && keys_[slot] != key) slot = (slot + 1) & (size - 1);
      if (keys_[slot] == kEmpty) keys_[slot] = key, numbers_[slot] = found++;
      ids[i] = numbers_[slot];
    }
    return found;
  }

 private:
  static constexpr std::uint64_t kEmpty = ~std::uint64_t{0};
  std::vector<std::uint64_t> keys_;
  std::vector<std::int32_t> numbers_;
};

// Sum of the phases of a window's points.
struct Phases {
  double cosine = 0.0, sine = 0.0, count = 0.0;

  // Sum of the cosines of the differences over all ordered pairs, and number of these pairs, both
  // divided by the number of points so that a full window does not outweigh all others.
  [[nodiscard]] double agreement() const {
    return count > 1.0 ? (cosine * cosine + sine * sine - count) / count : 0.0;
  }
  [[nodiscard]] double pairs() const { return count > 1.0 ? count - 1.0 : 0.0; }
};

// One of the two angles with its grid.
struct AngleComb {
  double step = 0.0;  // radians; 0: none
  double coherence = 0.0;
};

class Grid {
 public:
  /// @param progress  may cancel any of the work.
  Grid(std::vector<Vector3d> points, const Progress& progress)
      : points_(std::move(points)), ticker_(progress, 1) {}

  Vector3d position = Vector3d::Zero();
  AngleComb azimuth, elevation;

  static constexpr double kFinest = 0.02 * kDegree;
  static constexpr double kCoarsest = 2.0 * kDegree;

  void look() { sight_.look(points_, position); }

  // About so many points in some of the tiles around the position, whole; `draw` says which tiles.
  void keep_tiles(std::int64_t most, std::uint64_t draw) {
    look();
    const double share = static_cast<double>(most) / static_cast<double>(points_.size());
    if (share >= 1.0) return;
    std::vector<Vector3d> kept;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      if (uniform(draw, tile_of(i)) < share) kept.push_back(points_[i]);
    }
    points_ = std::move(kept);
    look();
  }

  [[nodiscard]] std::int64_t num_points() const {
    return static_cast<std::int64_t>(points_.size());
  }

  [[nodiscard]] double median_range() const {
    std::vector<double> ranges(sight_.range);
    return median(std::span(ranges));
  }

  // The largest step of [shortest, longest] at which phases agree nearly as well as at any, then
  // the most coherent of it and the three finer ones beside it. A grid of few of the points may
  // rule out most steps before.
  AngleComb find_comb(Angle angle, double shortest, double longest, Grid* few = nullptr) {
    constexpr double kRatio = 1.04;  // eight columns drift by a third of one
    constexpr double kNearly = 0.8;
    std::vector<AngleComb> tried;
    for (double step = shortest; step <= longest; step *= kRatio) tried.push_back({step, 1.0});
    if (few != nullptr) few->rule_out(angle, tried);
    double best = 0.0;
    for (AngleComb& comb : tried) {
      if (comb.coherence == 0.0) continue;
      comb.coherence = coherence(angle, comb.step, kWindows[0]);
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

  // Sets the coherence of steps to 0 that are not half as coherent as the best of them.
  void rule_out(Angle angle, std::vector<AngleComb>& steps) {
    constexpr double kHalf = 0.5;
    constexpr double kNoise = 0.01;  // three standard deviations, with kCombPoints
    double best = 0.0;
    for (AngleComb& comb : steps) {
      comb.coherence = coherence(angle, comb.step, kWindows[0]);
      best = std::max(best, comb.coherence);
    }
    const double least = std::max(kHalf * best, kFaint) - kNoise;
    for (AngleComb& comb : steps) {
      if (!(comb.coherence >= least)) comb.coherence = 0.0;
    }
  }

  // Finds faint rows where columns are plain. Their step is searched around that which gives one
  // point a cell, with the step of the columns known; and since a wrong height blurs rows, at nine
  // heights, of which the one with the most coherent rows is kept.
  void find_rows(double cell_area, double range) {
    constexpr int kHeights = 4;        // on either side
    constexpr double kHeight = 0.025;  // of the range
    constexpr double kUnsure = 1.6;    // factor of the distance: some rays have no return
    const Vector3d start = position;
    const double expected = std::clamp(cell_area / azimuth.step, kFinest, kCoarsest);
    AngleComb best;
    double height = start.z();
    for (int k = -kHeights; k <= kHeights; ++k) {
      position.z() = start.z() + k * kHeight * range;
      look();
      const AngleComb comb = find_comb(Angle::kElevation, expected / kUnsure, expected * kUnsure);
      if (comb.coherence > best.coherence) best = comb, height = position.z();
    }
    position.z() = height;
    elevation = best;
    look();
  }

  // Solid angle for each point, from the cells of one degree that hold some.
  [[nodiscard]] double cell_area() const {
    std::vector<std::uint8_t> seen(360 * 181);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const auto row = static_cast<std::size_t>((sight_.elevation[i] + kPi / 2.0) / kDegree);
      const auto column = static_cast<std::size_t>((sight_.azimuth[i] + kPi) / kDegree);
      seen[std::min<std::size_t>(row, 180) * 360 + std::min<std::size_t>(column, 359)] = 1;
    }
    const auto cells = static_cast<double>(std::count(seen.begin(), seen.end(), 1));
    return cells * kDegree * kDegree / static_cast<double>(points_.size());
  }

  // Mean cosine of the differences in phase between points of one window.
  double coherence(Angle angle, double step, const Window& window) {
    ticker_.tick();
    gather(angle, step, window);
    double agreement = 0.0;
    double pairs = 0.0;
    for (const Phases& phases : phases_) agreement += phases.agreement(), pairs += phases.pairs();
    return pairs > 0.0 ? agreement / pairs : 0.0;
  }

  // Coherence with the comb that was found; 0 if none was found.
  double judged(Angle angle, const Window& window) {
    const double step = comb(angle).step;
    return step > 0.0 ? coherence(angle, step, window) : 0.0;
  }

  AngleComb& comb(Angle angle) { return angle == Angle::kAzimuth ? azimuth : elevation; }

  // One step of Gauss and Newton on the differences of phases from their windows' means, in the
  // position (unless it is fixed) and in the logarithms of both steps. Returns metres moved.
  double improve(const Window& window, bool fixed) {
    Matrix5 normal = Matrix5::Zero();
    Vector5 gradient = Vector5::Zero();
    for (const Angle angle : kAngles) {
      AngleComb& found = comb(angle);
      if (found.step == 0.0) continue;
      found.coherence = coherence(angle, found.step, window);
      const double weight = std::max(found.coherence, 0.0) * std::max(found.coherence, 0.0);
      if (weight != 0.0) add_differences(angle, found.step, weight, normal, gradient);
    }
    if (fixed) {
      normal.topRows<3>().setZero();
      normal.leftCols<3>().setZero();
      gradient.head<3>().setZero();
    }
    // Damping: unknowns that no phase depends on do not move.
    normal.diagonal().array() += 1e-9 * normal.trace() + 1e-12;
    const Vector5 change = normal.ldlt().solve(gradient);
    position += change.head<3>();
    azimuth.step *= 1.0 + std::clamp(change[3], -kLargestChange, kLargestChange);
    elevation.step *= 1.0 + std::clamp(change[4], -kLargestChange, kLargestChange);
    look();
    return change.head<3>().norm();
  }

  // Mean over the tiles of the share of their points that stand on the grid. Only pairs of two such
  // points agree, so agreement goes with the square of the share, hence the root. It is measured
  // against the tile at 4/5 of all, as noise keeps even clean tiles below 1.
  double explained(Angle angle) {
    constexpr double kFewestPairs = 20.0;
    constexpr std::size_t kFewestTiles = 10;
    gather(angle, comb(angle).step, kJudged);
    std::vector<std::int64_t> tile(phases_.size());
    for (std::size_t i = 0; i < points_.size(); ++i) tile[ids_[i]] = tile_of(i);
    std::vector<double> agreement(kTilesAround * kTilesAround);
    std::vector<double> pairs(agreement.size());
    for (std::size_t w = 0; w < phases_.size(); ++w) {
      agreement[tile[w]] += phases_[w].agreement();
      pairs[tile[w]] += phases_[w].pairs();
    }
    std::vector<double> shares;
    for (std::size_t t = 0; t < pairs.size(); ++t) {
      if (pairs[t] < kFewestPairs) continue;
      shares.push_back(std::sqrt(std::max(0.0, agreement[t] / pairs[t])));
    }
    if (shares.size() < kFewestTiles) return 0.0;  // too little of a view to tell anything
    std::sort(shares.begin(), shares.end());
    const double usual = shares[shares.size() * 4 / 5];
    double sum = 0.0;
    for (const double share : shares) sum += std::min(1.0, share / std::max(usual, 1e-9));
    return sum / static_cast<double>(shares.size());
  }

 private:
  using Matrix5 = Eigen::Matrix<double, 5, 5>;
  using Vector5 = Eigen::Matrix<double, 5, 1>;  // x, y, z, and the logarithms of both steps

  static constexpr double kLargestChange = 0.02;  // of a step, in one go
  static constexpr double kSteepest = 1e3;        // radians of phase a metre: beside the axis
  static constexpr std::int64_t kTilesAround = 90;

  [[nodiscard]] std::int64_t tile_of(std::size_t i) const {
    const auto part = [](double angle) {
      return std::min(kTilesAround - 1, static_cast<std::int64_t>((angle + kPi) / kTile));
    };
    return part(sight_.elevation[i]) * kTilesAround + part(sight_.azimuth[i]);
  }

  // How the phase of a point changes with the five unknowns, radians.
  [[nodiscard]] Vector5 slope_of(std::size_t i, Angle angle, double step) const {
    Vector5 slope = Vector5::Zero();
    const Vector3d& ray = sight_.rays[i];
    const double rho = sight_.rho[i];
    const double squared = sight_.range[i] * sight_.range[i];
    if (angle == Angle::kAzimuth) {
      slope << ray.y() / (rho * rho), -ray.x() / (rho * rho), 0.0, -sight_.azimuth[i], 0.0;
    } else {
      slope << ray.z() * ray.x() / (rho * squared), ray.z() * ray.y() / (rho * squared),
          -rho / squared, 0.0, -sight_.elevation[i];
    }
    return Vector5((2.0 * kPi / step) * slope);
  }

  // Adds the normal equations of one angle, whose phases were gathered: the differences of phases
  // from the means of their windows are to vanish.
  void add_differences(Angle angle, double step, double weight, Matrix5& normal,
                       Vector5& gradient) {
    slopes_.assign(phases_.size(), Vector5::Zero());
    for (std::size_t i = 0; i < points_.size(); ++i) slopes_[ids_[i]] += slope_of(i, angle, step);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const Phases& phases = phases_[ids_[i]];
      if (!(phases.count > 1.0)) continue;
      // Sine and cosine of the difference from the window's mean.
      const double size =
          std::sqrt(phases.cosine * phases.cosine + phases.sine * phases.sine) + 1e-12;
      const SinCos own = waves_[i];
      const double cosine = (own.cos * phases.cosine + own.sin * phases.sine) / size;
      const double sine = (own.sin * phases.cosine - own.cos * phases.sine) / size;
      if (!(cosine > 0.0)) continue;
      const Vector5 slope = slope_of(i, angle, step) - slopes_[ids_[i]] / phases.count;
      if (!(slope.cwiseAbs().maxCoeff() < kSteepest)) continue;
      normal += (weight * cosine) * slope * slope.transpose();
      gradient -= (weight * cosine * sine) * slope;
    }
  }

  // Phases of all points, and their sums by window.
  void gather(Angle angle, double step, const Window& window) {
    const bool is_azimuth = angle == Angle::kAzimuth;
    const std::vector<double>& own = is_azimuth ? sight_.azimuth : sight_.elevation;
    const std::vector<double>& other = is_azimuth ? sight_.elevation : sight_.azimuth;
    const std::int64_t count = windows_.number(
        own, other, sight_.range, static_cast<double>(window.columns) * step, window.parts, ids_);
    phases_.assign(count, {});
    waves_.resize(points_.size());
    for (std::size_t i = 0; i < points_.size(); ++i) {
      waves_[i] = wave_of(own[i] / step);
      Phases& phases = phases_[ids_[i]];
      phases.cosine += waves_[i].cos;
      phases.sine += waves_[i].sin;
      phases.count += 1.0;
    }
  }

  std::vector<Vector3d> points_;
  Ticker ticker_;
  Sight sight_;
  Windows windows_;
  std::vector<std::int32_t> ids_;
  std::vector<Phases> phases_;
  std::vector<SinCos> waves_;
  std::vector<Vector5> slopes_;
};

// --- Putting it together -------------------------------------------------------------------------

constexpr double kCoherent = 0.6;    // of one angle; two scanners with equal shares reach 0.25
constexpr double kNoticeable = 0.1;  // of the elevations, which alone tell the height
constexpr double kPlain = 0.3;       // of either, in the narrowest windows

// Coordinates in the order that makes `axis` the third.
Vector3d turned(const Vector3d& p, int axis) {
  return {p[(axis + 1) % 3], p[(axis + 2) % 3], p[axis]};
}
Vector3d turned_back(const Vector3d& p, int axis) {
  Vector3d back;
  back[(axis + 1) % 3] = p[0], back[(axis + 2) % 3] = p[1], back[axis] = p[2];
  return back;
}

// The combs of both angles; one that is faint, or much fainter than the other, is left out.
void find_combs(Grid& grid) {
  Grid few = grid;
  few.keep_tiles(kCombPoints, 3);
  const bool are_enough = few.num_points() >= kCombPoints / 2;
  for (const Angle angle : kAngles) {
    AngleComb& comb = grid.comb(angle);
    comb = grid.find_comb(angle, Grid::kFinest, Grid::kCoarsest, are_enough ? &few : nullptr);
    if (!(comb.coherence >= kFaint)) comb = {};
  }
  const double plainer = std::max(grid.azimuth.coherence, grid.elevation.coherence);
  for (AngleComb* comb : {&grid.azimuth, &grid.elevation}) {
    if (plainer >= kPlain && comb->coherence < kPlain) *comb = {};  // would lead astray
  }
}

// Improves position and steps within one window until they converge. Returns false where the
// position goes so far from the first one that the first one is better.
bool converge(Grid& grid, const Vector3d& first, const Window& window, bool fixed, double range) {
  constexpr int kRounds = 30;
  constexpr int kFixedRounds = 3;      // of the steps alone
  constexpr double kConverged = 1e-5;  // of the median range
  constexpr double kFarthest = 0.2;    // of the median range
  for (int round = 0; round < kRounds; ++round) {
    if (grid.improve(window, fixed) <= kConverged * range && !fixed) break;
    if (!((grid.position - first).norm() <= kFarthest * range)) return false;
    if (fixed && round == kFixedRounds) break;
  }
  return true;
}

// Improves the grid in ever larger windows, as long as it stays coherent: encoders are not even
// over all columns. Returns false where there is no grid around this position.
bool improve_in_windows(Grid& grid, bool fixed, double cell_area, double range) {
  constexpr double kKept = 0.8;  // of the coherence, from one window to the next
  const Vector3d first = grid.position;
  double before = 0.0;
  for (const Window& window : kWindows) {
    const Vector3d position = grid.position;
    const AngleComb azimuth = grid.azimuth;
    const AngleComb elevation = grid.elevation;
    if (!converge(grid, first, window, fixed, range)) return false;
    const double coherence =
        std::max(grid.judged(Angle::kAzimuth, window), grid.judged(Angle::kElevation, window));
    if (!(coherence >= kKept * before)) {
      grid.position = position, grid.azimuth = azimuth, grid.elevation = elevation;
      grid.look();
      break;
    }
    if (before == 0.0 && coherence < kPlain) return false;
    if (before == 0.0 && grid.elevation.step == 0.0) grid.find_rows(cell_area, range);
    before = coherence;
  }
  return true;
}

// The source of a first position.
enum class Start : std::uint8_t {
  kKnown,   // it is judged, and stays
  kStated,  // the zero of the coordinates: one that fits nearly as well as the best is meant
  kGuessed  // only near
};

// The grid around a first position, and the position that fits it best.
ScanOrigin fit_grid(const Points& sample, const Vector3d& start, Start kind, int axis,
                    double thinned, const Progress& progress) {
  constexpr double kSame = 0.005;  // of the median range: a stated position is as good
  const bool fixed = kind == Start::kKnown;
  std::vector<Vector3d> points(sample.rows());
  for (Eigen::Index i = 0; i < sample.rows(); ++i) {
    points[i] = turned(sample.row(i).cast<double>().transpose(), axis);
  }
  Grid grid(std::move(points), progress);
  grid.position = turned(start, axis);
  ScanOrigin result;
  result.axis = axis;
  grid.look();
  const double cell_area = grid.cell_area() * thinned;
  grid.keep_tiles(kTilePoints, 2);
  if (grid.num_points() < kFewestPoints / 2) return result;
  const double range = grid.median_range();
  find_combs(grid);
  if (!improve_in_windows(grid, fixed, cell_area, range)) return result;
  result.azimuth_coherence = grid.judged(Angle::kAzimuth, kJudged);
  result.elevation_coherence = grid.judged(Angle::kElevation, kJudged);
  result.azimuth_step = grid.azimuth.step;
  result.elevation_step = grid.elevation.step;
  result.position = turned_back(grid.position, axis);
  const bool is_azimuth_plainer = result.azimuth_coherence >= result.elevation_coherence;
  result.found = std::max(result.azimuth_coherence, result.elevation_coherence) >= kCoherent &&
                 (fixed || result.elevation_coherence >= kNoticeable);
  if (result.found)
    result.explained = grid.explained(is_azimuth_plainer ? Angle::kAzimuth : Angle::kElevation);
  result.found = result.explained > 0.0;
  const bool is_near = (result.position - start).norm() <= kSame * range;
  if (result.found && kind != Start::kGuessed && is_near) result.position = start;
  return result;
}

}  // namespace

ScanOrigin estimate_scan_origin(const PointsView& view, const ScanOriginOptions& options,
                                const Progress& progress) {
  check_points_everywhere(view, options.num_threads, part_of(progress, 0.0, 0.0));
  const std::optional<Vector3d>& known = options.known;
  if (known && !known->allFinite()) throw InputError("origin: expected finite numbers");
  const Points sample = sample_points(view);
  if (sample.rows() < kFewestPoints) return {};
  const double thinned =
      std::min(1.0, static_cast<double>(kSampled) / static_cast<double>(view.num_points()));
  constexpr int kAxes[] = {2, 1, 0};
  int tried = 0;  // of the six positions and axes
  const auto next = [&] {
    const double done = tried++ / 6.0;
    return part_of(progress, done, done);
  };
  if (known || options.tries_zero) {
    const Vector3d start = known.value_or(Vector3d::Zero());
    for (const int axis : kAxes) {
      const Start kind = known ? Start::kKnown : Start::kStated;
      const ScanOrigin result = fit_grid(sample, start, kind, axis, thinned, next());
      if (result.found) return result;
    }
  }
  if (known) return {};
  tried = 3;
  const std::vector<Patch> patches = sample_patches(sample, part_of(progress, 0.5, 0.5));
  if (patches.size() < 100) return {};
  for (const int axis : kAxes) {
    const Progress part = next();
    const Vector3d start = even_position(patches, axis, part);
    const ScanOrigin result = fit_grid(sample, start, Start::kGuessed, axis, thinned, part);
    if (result.found) return result;
  }
  return {};
}

}  // namespace manip3d
