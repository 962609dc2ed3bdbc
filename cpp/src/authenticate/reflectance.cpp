#include "manip3d/authenticate/reflectance.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <span>
#include <string>
#include <utility>

#include "authenticate/natural_log.hpp"
#include "authenticate/range_windows.hpp"
#include "authenticate/ring_image.hpp"
#include "geometry/constants.hpp"
#include "geometry/median.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr float kNoReflectance = std::numeric_limits<float>::quiet_NaN();

// Azimuth columns of ReflectanceView: finer than the firings of the scanner, so that a column holds
// at most one return of a laser.
constexpr int kFineColumns = 4000;
// Points of another turn are searched within this many lasers and fine columns.
constexpr int kLookRings = 2;
constexpr int kLookColumns = 4;
constexpr std::size_t kMaxBeside = 3;      // points of another turn that are averaged
constexpr double kBesideSoftening = 0.05;  // metres: weights are 1 / (distance + this)

// Azimuth columns in which neighbouring lasers are compared: one firing in each.
constexpr int kGainColumns = 2000;
// With at most this many pairs of returns, two lasers are taken to have the same gain.
constexpr std::size_t kTooFewGains = 50;

// Voxels of the evidence: two lasers, 1.44 degrees, and a quarter of an octave of range.
constexpr int kShareRings = 2;
constexpr int kShareColumns = 250;

// Energies (squared differences of reflectance, divided by kEditVariance or kApartVariance). With
// independent noise of variance s in all three turns, E = I - (P + N) / 2 has the variance 3/2 s,
// and D = P - N has 2 s; see compare_reflectance().
constexpr double kEditVariance = 1.5;
constexpr double kApartVariance = 2.0;
// The energy of a point is clipped, so that no single point decides.
constexpr double kMaxEnergy = 0.06;
// This is added to both energies of each point before their ratio is taken: reflectances come in
// hundredths, and half of the points have less noise than 0.03, so that smaller energies mean
// nothing.
constexpr double kMinEnergy = 0.0008;
// A window is evidence above this ratio. Few windows of clean frames exceed it, and fewer still if
// any pair of lasers may be left out.
constexpr double kEnergyRatio = 3.0;
// The mean of E over a window is tested as well, because it alone shows surfaces that were scaled
// or shifted by less than their noise. Its variance in clean frames is taken as this share of the
// energy of a point (the points of a window are not independent), plus kMinMean.
constexpr double kMeanShare = 0.25;
constexpr double kMinMean = 0.0004;
constexpr double kMaxExcess = 2.0;  // largest excess of a window over kEnergyRatio that counts
constexpr int kMinCompared = 20;    // points of a window
constexpr int kMinWithout = 10;     // points of a window without one pair of lasers

// On a surface that was painted with one value, neighbours have the same reflectance with this
// probability. For a clean one it is estimated for each laser, within the two limits below.
constexpr double kEvenShare = 0.75;
constexpr double kMinEven = 0.08;
constexpr double kMaxEven = 0.7;
constexpr double kMinEvenGain = 0.05;  // least difference between painted and clean
// Prior counts of equal pairs and of all pairs of a laser: the shot noise of the scanner leaves
// about one pair in eight with the same hundredth.
constexpr double kPriorEqual = 5.0;
constexpr double kPriorPairs = 30.0;
constexpr double kEvenRatio = 5.0;   // log likelihood ratio above which a window is evidence
constexpr double kEvenGap = 0.0075;  // radians: farthest neighbours along a ring

// Largest difference of two ranges on one surface: a share of the range, and metres for rough
// surfaces. From a ray to the next one, an angle d apart, the range of a surface that is met at an
// angle s changes by the share d / tan(s).
struct OneSurface {
  double share;
  double slack;
};
constexpr OneSurface kAlongRing{0.03, 0.05};   // kEvenGap apart, met at 14 degrees or more
constexpr OneSurface kAcrossRings{0.08, 0.1};  // lasers a third of a degree apart, 4 degrees

// Are two ranges a and b, metres, those of one surface?
bool is_one_surface(double a, double b, const OneSurface& most) {
  return std::abs(a - b) < most.share * a + most.slack;
}

double range_of(const PointsView& view, Eigen::Index row) {
  return std::sqrt(view.points.row(row).cast<double>().squaredNorm());
}

// End of the scale of reflectances at which a value is clipped.
enum class End : std::uint8_t { kNone, kLow, kHigh };

// The scale of reflectances of a scan. Its smallest and largest values count as clipped.
struct ReflectanceScale {
  explicit ReflectanceScale(const PointsView& view)
      : lowest(view.intensity.size() > 0 ? view.intensity.minCoeff() : 0.0F),
        highest(view.intensity.size() > 0 ? view.intensity.maxCoeff() : 0.0F) {}
  // Is the value not clipped?
  [[nodiscard]] bool holds(float value) const { return value > lowest && value < highest; }
  [[nodiscard]] End end(float value) const {
    if (holds(value)) return End::kNone;
    return value <= lowest ? End::kLow : End::kHigh;
  }
  float lowest, highest;
};

// The point nearest to the scanner in each direction (ring, fine column). Coordinates are in
// separate arrays, and `reach` columns are repeated at both ends of a ring, so that 2 * reach + 1
// neighbouring columns are adjacent in memory everywhere on the turn.
class NearestImage {
 public:
  NearestImage(int rings, int columns, int reach)
      : rings_(rings), columns_(columns), reach_(reach), width_(columns + 2 * reach) {
    for (std::vector<float>& axis : axes_) {
      axis.assign(std::int64_t{rings} * width_, std::numeric_limits<float>::infinity());
    }
    rows_.assign(std::int64_t{rings} * width_, -1);
  }

  [[nodiscard]] int rings() const { return rings_; }

  /// Row of the point in a direction; -1: no point.
  [[nodiscard]] std::int32_t row(int ring, int column) const {
    return rows_[first(ring, column) + reach_];
  }

  void set(int ring, int column, const Eigen::RowVector3f& place, std::int32_t row) {
    const std::int64_t at = first(ring, column) + reach_;
    put(at, place, row);
    if (column < reach_) put(at + columns_, place, row);
    if (column >= columns_ - reach_) put(at - columns_, place, row);
  }

  /// Index of the first of the 2 * reach + 1 columns around a column.
  [[nodiscard]] std::int64_t first(int ring, int column) const {
    return std::int64_t{ring} * width_ + column;
  }
  [[nodiscard]] const float* axis(int k, std::int64_t at) const { return axes_[k].data() + at; }
  [[nodiscard]] const std::int32_t* rows(std::int64_t at) const { return rows_.data() + at; }

 private:
  void put(std::int64_t at, const Eigen::RowVector3f& place, std::int32_t row) {
    for (int k = 0; k < 3; ++k) axes_[k][at] = place[k];
    rows_[at] = row;
  }

  int rings_, columns_, reach_;
  std::int64_t width_;
  std::array<std::vector<float>, 3> axes_;  // infinite where there is no point
  std::vector<std::int32_t> rows_;
};

// The reflectances of another turn without the gain of each laser, indexed by direction from the
// place of the frame's scanner.
class ReflectanceView {
 public:
  // Squared search radius, exact and rounded up to single precision.
  struct Reach {
    explicit Reach(double metres)
        : squared(metres * metres),
          upper(std::nextafter(static_cast<float>(squared),
                               std::numeric_limits<float>::infinity())) {}
    double squared;
    float upper;
  };

  // Mean reflectances of the points around a place; NaN if there are none within reach.
  struct Seen {
    double measured = kNoReflectance;  // mean of points that are not clipped
    double all = kNoReflectance;       // mean of all points
    End end = End::kNone;              // the end of the scale at which all of them are clipped
  };

  ReflectanceView(const ReflectanceTurn& turn, const ScanLattice& lattice,
                  const std::vector<double>& gains, int num_threads, const Progress& progress)
      : measured_(lattice.num_rings(), kFineColumns, kLookColumns), all_(measured_) {
    const PointsView& view = turn.points;
    const LatticeReading own = read_lattice(view, lattice, num_threads, progress);
    Points places(view.num_points(), 3);
    const Eigen::Matrix3f rotation = turn.motion.rotation.cast<float>();
    const Eigen::RowVector3f shift = turn.motion.translation.transpose().cast<float>();
    const ReflectanceScale scale(view);
    reflectance_.assign(view.num_points(), kNoReflectance);
    ends_.assign(view.num_points(), End::kNone);
    for (Eigen::Index i = 0; i < view.num_points(); ++i) {
      places.row(i) = (rotation * view.points.row(i).transpose()).transpose() + shift;
      if (!places.row(i).allFinite()) places.row(i).setZero();  // overflow: no scanner sees so far
      if (own.ring(i) < 0) continue;
      const auto gain = static_cast<float>(gains[own.ring(i)]);
      reflectance_[i] = view.intensity(i) - gain;
      ends_[i] = scale.end(view.intensity(i));
    }
    const PointsView moved(PointsView::Map<Points>(places.data(), places.rows(), 3));
    LatticeReading read;
    if (turn.seen == nullptr) read = read_lattice(moved, lattice, num_threads, progress);
    const LatticeReading& seen = turn.seen == nullptr ? read : *turn.seen;
    for (Eigen::Index i = 0; i < places.rows(); ++i) {
      if (seen.ring(i) < 0 || std::isnan(reflectance_[i])) continue;
      const int column = azimuth_column(seen.azimuth(i), kFineColumns);
      const auto keep_nearest = [&](NearestImage& image) {
        const std::int32_t first = image.row(seen.ring(i), column);
        if (first >= 0 && !(places.row(i).squaredNorm() < places.row(first).squaredNorm())) return;
        image.set(seen.ring(i), column, places.row(i), static_cast<std::int32_t>(i));
      };
      keep_nearest(all_);
      if (ends_[i] == End::kNone) keep_nearest(measured_);
    }
  }

  // Weighted means of the nearest points around a place; see kBesideSoftening.
  [[nodiscard]] Seen beside(const Eigen::RowVector3f& place, int ring, int column,
                            const Reach& reach) const {
    const Nearest around = nearest(all_, place, ring, column, reach);
    Seen seen;
    seen.all = mean_of(around);
    bool is_any_clipped = false;
    bool is_one_end = around.count > 0;
    for (std::size_t k = 0; k < around.count; ++k) {
      const End end = ends_[around.best[k].row];
      is_any_clipped |= end != End::kNone;
      is_one_end &= end == ends_[around.best[0].row];
    }
    if (is_one_end) seen.end = ends_[around.best[0].row];
    seen.measured =
        is_any_clipped ? mean_of(nearest(measured_, place, ring, column, reach)) : seen.all;
    return seen;
  }

 private:
  static constexpr int kLookAround = 2 * kLookColumns + 1;
  static_assert(kMaxBeside == 3);

  struct Beside {
    float squared = 0.0F;
    std::int32_t row = -1;
    bool operator<(const Beside& other) const {
      return squared < other.squared || (squared == other.squared && row < other.row);
    }
  };

  // The nearest points within reach.
  struct Nearest {
    std::array<Beside, kMaxBeside> best;
    std::size_t count = 0;
  };

  static Nearest nearest(const NearestImage& image, const Eigen::RowVector3f& place, int ring,
                         int column, const Reach& reach) {
    Nearest found;
    std::array<Beside, kMaxBeside>& best = found.best;
    std::size_t worst = 0;
    float bound = reach.upper;  // points farther than this cannot be among the nearest
    for (int r = std::max(0, ring - kLookRings);
         r <= std::min(image.rings() - 1, ring + kLookRings); ++r) {
      const std::int64_t first = image.first(r, column);
      const std::array<float, kLookAround> squared = squared_distances(image, first, place);
      if (!is_any_within(squared, bound)) continue;
      const std::int32_t* const rows = image.rows(first);
      for (int k = 0; k < kLookAround; ++k) {
        if (!(squared[k] <= bound)) continue;
        const Beside at{squared[k], rows[k]};
        if (found.count < kMaxBeside) {
          if (!(static_cast<double>(at.squared) < reach.squared)) continue;
          best[found.count++] = at;
        } else if (at < best[worst]) {
          best[worst] = at;
        }
        if (found.count < kMaxBeside) continue;
        worst = best[0] < best[1] ? 1 : 0;
        if (best[worst] < best[2]) worst = 2;
        bound = best[worst].squared;
      }
    }
    return found;
  }

  [[nodiscard]] double mean_of(const Nearest& around) const {
    if (around.count == 0) return kNoReflectance;
    double sum = 0.0;
    double weights = 0.0;
    for (std::size_t k = 0; k < around.count; ++k) {
      const double weight =
          1.0 / (std::sqrt(static_cast<double>(around.best[k].squared)) + kBesideSoftening);
      sum += weight * static_cast<double>(reflectance_[around.best[k].row]);
      weights += weight;
    }
    return sum / weights;
  }

  [[nodiscard]] static std::array<float, kLookAround> squared_distances(
      const NearestImage& image, std::int64_t first, const Eigen::RowVector3f& place) {
    const float* const x = image.axis(0, first);
    const float* const y = image.axis(1, first);
    const float* const z = image.axis(2, first);
    std::array<float, kLookAround> squared;
    for (int k = 0; k < kLookAround; ++k) {
      const float a = x[k] - place[0];
      const float b = y[k] - place[1];
      const float c = z[k] - place[2];
      squared[k] = a * a + (b * b + c * c);
    }
    return squared;
  }

  // No branch for each value: most runs of columns hold no point within the bound.
  [[nodiscard]] static bool is_any_within(const std::array<float, kLookAround>& squared,
                                          float bound) {
    int within = 0;
    for (const float each : squared) within |= each <= bound ? 1 : 0;
    return within != 0;
  }

  std::vector<float> reflectance_;
  std::vector<End> ends_;
  NearestImage measured_, all_;  // images without and with clipped points
};

// Sums over the points of a voxel or window. E and D: see compare_reflectance().
struct ReflectanceTally {
  int points = 0;
  double first = 0.0;   // kEven: log likelihood ratio; kChanged: energies of E
  double second = 0.0;  // kChanged: energies of D
  double metres = 0.0;  // kChanged: distances of the points from the scanner
  double edit = 0.0;    // kChanged: E
  double apart = 0.0;   // kChanged: D
};

ReflectanceTally operator+(const ReflectanceTally& a, const ReflectanceTally& b) {
  return {a.points + b.points, a.first + b.first, a.second + b.second,
          a.metres + b.metres, a.edit + b.edit,   a.apart + b.apart};
}

// A voxel and the 26 around it: the sums of the row above, of its own row, and of the row below.
using ReflectanceWindow = std::array<ReflectanceTally, 3>;

class ReflectanceSearch {
 public:
  ReflectanceSearch(const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
                    const ReflectanceOptions& options, const Progress& progress)
      : points_(points),
        lattice_(lattice),
        options_(options),
        progress_(progress),
        scale_(points),
        reading_(std::move(reading)),
        voxels_((lattice.num_rings() + kShareRings - 1) / kShareRings, kShareColumns),
        ranges_(points.num_points(), 0.0) {
    for (Eigen::Index i = 0; i < points.num_points(); ++i) {
      if (reading_.ring(i) < 0) continue;
      const double range = range_of(points, i);
      if (!(range > options.nearest && range < options.farthest)) continue;
      ranges_[i] = range;
      voxels_.add(voxel_of(i));
    }
    voxels_.number();
  }

  [[nodiscard]] std::vector<ReflectanceRegion> run(const ReflectanceTurn* previous,
                                                   const ReflectanceTurn* following) {
    std::vector<ReflectanceRegion> regions;
    find_even(regions);
    if (previous != nullptr && following != nullptr) find_changed(*previous, *following, regions);
    return regions;
  }

 private:
  using Tallies = std::vector<ReflectanceTally>;  // by voxel
  using Strengths = std::vector<float>;           // by voxel; 0: no evidence

  // Is a point tested? It must be within range and, for kEven, not clipped.
  [[nodiscard]] bool is_judged(ReflectanceEvidence kind, Eigen::Index i) const {
    if (!(ranges_[i] > 0.0)) return false;
    return kind == ReflectanceEvidence::kChanged || scale_.holds(points_.intensity(i));
  }

  [[nodiscard]] RangeVoxel voxel_of(Eigen::Index i) const {
    return {reading_.ring(i) / kShareRings, azimuth_column(reading_.azimuth(i), kShareColumns),
            range_layer(points_.points.row(i).squaredNorm())};
  }

  ReflectanceTally& tally_of(Tallies& tallies, Eigen::Index i) const {
    return tallies[voxels_.find(voxel_of(i))];
  }

  // The rows of each laser's points, sorted by azimuth.
  [[nodiscard]] std::vector<std::vector<std::int32_t>> rows_by_azimuth() const {
    std::vector<std::vector<std::int32_t>> rows(lattice_.num_rings());
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) >= 0) rows[reading_.ring(i)].push_back(i);
    }
    const auto comes_first = [&](std::int32_t a, std::int32_t b) {
      return reading_.azimuth(a) < reading_.azimuth(b);
    };
    Ticker ticker(progress_, 1);
    for (std::vector<std::int32_t>& of_ring : rows) {
      ticker.tick();
      if (!std::is_sorted(of_ring.begin(), of_ring.end(), comes_first)) {
        std::stable_sort(of_ring.begin(), of_ring.end(), comes_first);
      }
    }
    return rows;
  }

  // Finds surfaces that were painted with one value, or with the values of a few neighbours. See
  // kPriorEqual for clean surfaces.
  void find_even(std::vector<ReflectanceRegion>& regions) const {
    struct Pair {
      std::int32_t row;
      int ring;
      bool same;
    };
    Ticker ticker(progress_);
    std::vector<Pair> pairs;
    std::vector<double> same(lattice_.num_rings(), kPriorEqual);
    std::vector<double> all(same.size(), kPriorPairs);
    for (const std::vector<std::int32_t>& rows : rows_by_azimuth()) {
      for (std::size_t k = 1; k < rows.size(); ++k) {
        ticker.tick();
        const std::int32_t a = rows[k - 1];
        const std::int32_t b = rows[k];
        if (!is_judged(ReflectanceEvidence::kEven, a)) continue;
        if (!is_judged(ReflectanceEvidence::kEven, b)) continue;
        if (!(reading_.azimuth(b) - reading_.azimuth(a) < kEvenGap)) continue;
        if (!is_one_surface(ranges_[a], ranges_[b], kAlongRing)) continue;
        const std::size_t ring = reading_.ring(a);
        const bool equal = points_.intensity(a) == points_.intensity(b);
        pairs.push_back({a, reading_.ring(a), equal});
        same[ring] += equal ? 1.0 : 0.0;
        all[ring] += 1.0;
      }
    }
    // Log likelihood ratios (painted over clean) of a pair that differs and of an equal pair.
    std::vector<std::array<double, 2>> ratios;
    for (std::size_t ring = 0; ring < same.size(); ++ring) {
      const double clean = std::clamp(same[ring] / all[ring], kMinEven, kMaxEven);
      const double even = std::max(kEvenShare, clean + kMinEvenGain);
      ratios.push_back({natural_log((1.0 - even) / (1.0 - clean)), natural_log(even / clean)});
    }
    Tallies tallies(voxels_.size());
    for (const Pair& pair : pairs) {
      ReflectanceTally& tally = tally_of(tallies, pair.row);
      ++tally.points;
      tally.first += ratios[pair.ring][pair.same ? 1 : 0];
    }
    Strengths strengths(voxels_.size(), 0.0F);
    raise_to(strengths, tallies, may_be_even, even_strength);
    add_regions(ReflectanceEvidence::kEven, strengths, regions);
  }

  // Finds surfaces whose reflectance differs from that in both neighbouring turns.
  void find_changed(const ReflectanceTurn& previous, const ReflectanceTurn& following,
                    std::vector<ReflectanceRegion>& regions) const {
    const std::vector<double> gains = laser_gains(points_, reading_, lattice_.num_rings());
    const std::array<ReflectanceView, 2> views{
        ReflectanceView(previous, lattice_, gains, options_.num_threads, progress_),
        ReflectanceView(following, lattice_, gains, options_.num_threads, progress_)};
    Ticker ticker(progress_);
    // Clipping hides a part of a difference. Therefore windows are judged twice, without clipped
    // returns (`measured`) and with them (`all`), and the stronger evidence counts.
    Tallies measured(voxels_.size());
    Tallies all(voxels_.size());
    const ReflectanceView::Reach reach(options_.reach);
    for (Eigen::Index i = 0; i < points_.num_points(); ++i) {
      ticker.tick();
      if (!is_judged(ReflectanceEvidence::kChanged, i)) continue;
      const int column = azimuth_column(reading_.azimuth(i), kFineColumns);
      const auto seen = [&](const ReflectanceView& view) {
        return view.beside(points_.points.row(i), reading_.ring(i), column, reach);
      };
      const ReflectanceView::Seen before = seen(views[0]);
      const ReflectanceView::Seen after = seen(views[1]);
      const double here = points_.intensity(i) - gains[reading_.ring(i)];
      const auto compare = [&](Tallies& tallies, double earlier, double later) {
        if (std::isnan(earlier) || std::isnan(later)) return;
        const double edit = here - (earlier + later) / 2.0;
        const double apart = earlier - later;
        ReflectanceTally& tally = tally_of(tallies, i);
        ++tally.points;
        tally.first += std::min(edit * edit / kEditVariance, kMaxEnergy);
        tally.second += std::min(apart * apart / kApartVariance, kMaxEnergy);
        tally.metres += ranges_[i];
        tally.edit += edit;
        tally.apart += apart;
      };
      const End end = scale_.end(points_.intensity(i));
      if (end == End::kNone) compare(measured, before.measured, after.measured);
      // A return that is clipped at the same end in all three turns says nothing.
      if (end != End::kNone && end == before.end && end == after.end) continue;
      compare(all, before.all, after.all);
    }
    Strengths strengths(voxels_.size(), 0.0F);
    for (const Tallies& tallies : {std::cref(measured), std::cref(all)}) {
      raise_to(strengths, tallies, has_points, changed_strength);
    }
    add_regions(ReflectanceEvidence::kChanged, strengths, regions);
  }

  [[nodiscard]] ReflectanceWindow window_around(const Tallies& tallies,
                                                const RangeVoxel& at) const {
    ReflectanceWindow window;
    const int columns = voxels_.columns();
    const int near = std::max(0, at.layer - 1);
    const int far = std::min(RangeVoxels::kLayers - 1, at.layer + 1);
    for (int r = std::max(0, at.row - 1); r <= std::min(voxels_.rows() - 1, at.row + 1); ++r) {
      ReflectanceTally& sum = window[r - at.row + 1];
      for (int d = -1; d <= 1; ++d) {
        const auto [first, last] =
            voxels_.numbers(r, (at.column + d + columns) % columns, near, far);
        for (std::int32_t k = first; k < last; ++k) sum = sum + tallies[k];
      }
    }
    return window;
  }

  // Ratio of the difference between the frame and both turns to the difference between the turns:
  // that of the energies of points or of the squares of means, whichever is larger.
  static double changed_ratio(const ReflectanceTally& sum) {
    const double floor = kMinEnergy * sum.points;
    const double energies = (sum.first + floor) / (sum.second + floor);
    const double edit = sum.edit / sum.points;
    const double apart = sum.apart / sum.points;
    const double noise =
        kMeanShare * sum.second / sum.points + apart * apart / kApartVariance + kMinMean;
    return std::max(energies, (edit * edit / kEditVariance + kMinMean) / noise);
  }

  // The ratio of a window: the smallest of those with all lasers and without one of its three rows
  // of voxels. A single laser that runs along a kerb may be on one side of it in this turn, and on
  // the other side in both neighbouring turns.
  static double changed_ratio(const ReflectanceWindow& window) {
    const ReflectanceTally all = window[0] + window[1] + window[2];
    if (all.points < kMinCompared) return 0.0;
    double least = changed_ratio(all);
    for (const ReflectanceTally& without :
         {window[1] + window[2], window[0] + window[2], window[0] + window[1]}) {
      if (without.points < kMinWithout) return 0.0;
      least = std::min(least, changed_ratio(without));
    }
    return least;
  }

  // Can a voxel add to a region, whatever its window? Few voxels of clean frames can by
  // may_be_even(), so that few windows have to be summed.
  static bool has_points(const ReflectanceTally& own) { return own.points > 0; }
  static bool may_be_even(const ReflectanceTally& own) { return own.first > 0.0; }

  // The strength that such a voxel adds to its region; 0: its window is no evidence.
  static double even_strength(const ReflectanceTally& own, const ReflectanceWindow& window) {
    const double ratio = window[0].first + window[1].first + window[2].first;
    return ratio > kEvenRatio ? own.first : 0.0;
  }

  static double changed_strength(const ReflectanceTally& own, const ReflectanceWindow& window) {
    const double excess = std::min(changed_ratio(window) / kEnergyRatio - 1.0, kMaxExcess);
    return excess > 0.0 ? own.metres * excess : 0.0;  // near surfaces have more points
  }

  // Raises each strength to that of `strength_of` for these tallies, if the latter is larger.
  template <class CanAdd, class StrengthOf>
  void raise_to(Strengths& strengths, const Tallies& tallies, CanAdd can_add,
                StrengthOf strength_of) const {
    for (std::size_t k = 0; k < voxels_.size(); ++k) {
      if (!can_add(tallies[k])) continue;
      const ReflectanceWindow window = window_around(tallies, voxels_.voxels()[k]);
      strengths[k] = std::max(strengths[k], static_cast<float>(strength_of(tallies[k], window)));
    }
  }

  // Appends a region for each connected set of directions with a voxel of positive strength.
  void add_regions(ReflectanceEvidence kind, const Strengths& strengths,
                   std::vector<ReflectanceRegion>& regions) const {
    RingImage<std::uint8_t> suspect(voxels_.rows(), voxels_.columns(), 0);
    for (std::size_t k = 0; k < voxels_.size(); ++k) {
      const RangeVoxel& at = voxels_.voxels()[k];
      if (strengths[k] > 0.0F) suspect(at.row, at.column) = 1;
    }
    const std::size_t first = regions.size();
    RingImage<std::int32_t> region_of(voxels_.rows(), voxels_.columns(), -1);
    for (const auto& component : connected_components(suspect)) {
      ReflectanceRegion found{kind, 0.0, {}};
      for (const auto& [row, column] : component) {
        region_of(row, column) = static_cast<std::int32_t>(regions.size());
        const auto [begin, end] = voxels_.numbers(row, column, 0, RangeVoxels::kLayers - 1);
        for (std::int32_t k = begin; k < end; ++k) {
          found.strength += strengths[k];
        }
      }
      regions.push_back(std::move(found));
    }
    if (regions.size() == first) return;
    for (Eigen::Index i = 0; i < points_.num_points(); ++i) {
      if (!is_judged(kind, i)) continue;
      const RangeVoxel at = voxel_of(i);
      if (!(strengths[voxels_.find(at)] > 0.0F)) continue;
      regions[region_of(at.row, at.column)].rows.push_back(static_cast<std::int32_t>(i));
    }
  }

  const PointsView& points_;
  const ScanLattice& lattice_;
  const ReflectanceOptions& options_;
  const Progress& progress_;
  ReflectanceScale scale_;
  LatticeReading reading_;
  RangeVoxels voxels_;
  std::vector<double> ranges_;  // metres; 0: out of range
};

void check_reflectance(const PointsView& view, const char* name) {
  check_points(view);
  if (view.num_points() > 0 && !view.has_intensity()) {
    throw InputError(std::string(name) + ": expected points with a reflectance, got none");
  }
  for (Eigen::Index i = 0; i < view.intensity.size(); ++i) {
    if (view.intensity(i) >= 0.0F && view.intensity(i) <= 1.0F) continue;
    throw InputError(std::string(name) + ": expected reflectances in [0, 1], got " +
                     number_text(view.intensity(i)) + " in row " + std::to_string(i));
  }
}

void check_reflectance_options(const ReflectanceOptions& options) {
  if (!(options.nearest > 0.0 && options.farthest > options.nearest)) {
    throw InputError("nearest: expected 0 < nearest < farthest");
  }
  if (!(options.reach > 0.0 && options.reach < 10.0)) {
    throw InputError("reach: expected metres in (0, 10), got " + number_text(options.reach));
  }
}

void check_compared(const PointsView& points, const ScanLattice& lattice,
                    const ReflectanceTurn* previous, const ReflectanceTurn* following,
                    const ReflectanceOptions& options) {
  check_reflectance_options(options);
  check_reflectance(points, "frame");
  if (previous != nullptr) check_reflectance(previous->points, "previous");
  if (following != nullptr) check_reflectance(following->points, "following");
  for (const ReflectanceTurn* turn : {previous, following}) {
    if (turn != nullptr && turn->seen != nullptr) check_reading(*turn->seen, turn->points, lattice);
  }
}

}  // namespace

std::vector<double> laser_gains(const PointsView& points, const LatticeReading& reading,
                                int num_rings) {
  RingImage<std::int32_t> image(num_rings, kGainColumns, -1);
  const ReflectanceScale scale(points);
  for (Eigen::Index i = 0; i < points.num_points(); ++i) {
    if (reading.ring(i) < 0 || !scale.holds(points.intensity(i))) continue;
    image(reading.ring(i), azimuth_column(reading.azimuth(i), kGainColumns)) =
        static_cast<std::int32_t>(i);
  }
  std::vector<double> gains(num_rings, 0.0);
  for (int ring = 1; ring < num_rings; ++ring) {
    std::vector<float> steps;
    for (int column = 0; column < kGainColumns; ++column) {
      const std::int32_t above = image(ring - 1, column);
      const std::int32_t below = image(ring, column);
      if (above < 0 || below < 0) continue;
      if (!is_one_surface(range_of(points, below), range_of(points, above), kAcrossRings)) continue;
      steps.push_back(points.intensity(below) - points.intensity(above));
    }
    const double step =
        steps.size() > kTooFewGains ? static_cast<double>(median(std::span(steps))) : 0.0;
    gains[ring] = gains[ring - 1] + step;
  }
  const double mean = std::accumulate(gains.begin(), gains.end(), 0.0) / std::max(num_rings, 1);
  for (double& gain : gains) gain -= mean;
  return gains;
}

std::vector<ReflectanceRegion> compare_reflectance(
    const PointsView& points, const ScanLattice& lattice, const ReflectanceTurn* previous,
    const ReflectanceTurn* following, const ReflectanceOptions& options, const Progress& progress) {
  check_compared(points, lattice, previous, following, options);
  return ReflectanceSearch(points, lattice,
                           read_lattice(points, lattice, options.num_threads, progress), options,
                           progress)
      .run(previous, following);
}

std::vector<ReflectanceRegion> compare_reflectance(
    const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
    const ReflectanceTurn* previous, const ReflectanceTurn* following,
    const ReflectanceOptions& options, const Progress& progress) {
  check_compared(points, lattice, previous, following, options);
  check_reading(reading, points, lattice);
  return ReflectanceSearch(points, lattice, std::move(reading), options, progress)
      .run(previous, following);
}

}  // namespace manip3d
