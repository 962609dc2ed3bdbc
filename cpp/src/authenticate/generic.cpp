#include "manip3d/authenticate/generic.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <optional>
#include <span>
#include <utility>

#include "authenticate/file_order.hpp"
#include "authenticate/ground_plane.hpp"
#include "authenticate/lattice_places.hpp"
#include "authenticate/range_windows.hpp"
#include "authenticate/ring_image.hpp"
#include "authenticate/void_search.hpp"
#include "geometry/constants.hpp"
#include "geometry/median.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

// Float32 holds a coordinate of 100 m to 4 micrometres.
constexpr double kFloatRounding = 1e-5;  // metres

// A rotation and a shift of some 100 m in single precision, and back, leave 33 micrometres at most
// in a frame that they do not spoil as a whole. Of coordinates that are anything, one point in a
// thousand is as near to its step in all three.
constexpr double kFloatArithmetic = 5e-5;  // metres

// A million windows of clean ranges reach this exponent in 2 % of the frames at most.
constexpr double kWindowThreshold = 18.0;

// Metres by which a coordinate may be farther from its place on the lattice than rounding moves it:
// of the 5.7 million points of 47 frames of KITTI, of which ten gave the lattice, none needs more
// than 0.13 mm.
constexpr double kPlaceMargin = 0.00025;

// Coordinates of whole millimetres leave an error that averages out; what was moved along rays from
// the scanner's centre leaves the lines of lasers that are beside it, all points by the same.
// Windows of so many rows of cells and columns to each side are averaged.
constexpr int kDriftRows = 1;
constexpr int kDriftColumns = 2;
constexpr std::int32_t kFewestDrifting = 8;
constexpr std::size_t kFewestDriftWindows = 1000;
constexpr double kDriftGate = 0.0012;    // metres from the line: what is farther speaks for itself
constexpr double kDriftThreshold = 8.0;  // deviations; clean windows of KITTI's frames reach 7.6
constexpr double kRoundingShare = 0.2887;  // 1 / sqrt(12): deviation of an even spread
constexpr double kNormalMad = 1.4826;      // deviation of a normal spread over its median

// Where the turn before was answered, fewer answers beside a gap will do: 6 of 8.
constexpr int kAnsweredBesideInTime = 6;

// Sectors of 5 degrees in which evidence is told from what was done to the whole frame; one is
// spoiled by the stray points of 2 in 100, which rounding and resampling leave everywhere.
constexpr std::size_t kSectors = 72;
constexpr std::int64_t kFewestOfSector = 100;
constexpr std::size_t kFewestSectors = 8;
constexpr double kSpoiledShare = 0.02;
// The share is 1 in 200 for places: clean frames have none that stray, and whoever cuts coordinates
// to whole millimetres by a product in single precision moves every hundredth of them by one.
constexpr double kSpoiledPlaces = 0.005;

constexpr std::size_t index_of(Evidence evidence) { return static_cast<std::size_t>(evidence); }

using Strength = std::array<double, kNumEvidence>;
using SectorTally = std::array<std::int64_t, kSectors>;

// One frame on its way through the stages; each stage fills in what the later ones need.
class Examination {
 public:
  Examination(const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
              const GenericOptions& options, const PointsView& previous,
              const PointsView& following, const Progress& progress)
      : points_(points),
        beside_{&previous, &following},
        lattice_(lattice),
        options_(options),
        progress_(progress),
        reading_(std::move(reading)),
        cells_((lattice.num_rings() + kCellRings - 1) / kCellRings, kCellColumns, Strength{}),
        voxels_(cells_.rings(), cells_.columns()),
        voxel_of_point_(points.num_points(), -1) {
    result_.flags.assign(points.num_points(), 0);
    num_read_ = (reading_.ring.array() >= 0).count();
    for (std::int32_t i = 0; i < points.num_points(); ++i) {
      if (reading_.ring(i) < 0) continue;
      ++sectors_[sector(i)];
      voxels_.add(voxel_of(i));
    }
    voxels_.number();
    for (std::int32_t i = 0; i < points.num_points(); ++i) {
      if (reading_.ring(i) >= 0) voxel_of_point_[i] = voxels_(voxel_of(i));
    }
    if (options.azimuth_error > 0.0 && lattice.steps > 0) forget_uncertain_counts();
  }

  GenericResult run() {
    using Stage = void (Examination::*)();
    constexpr Stage kStages[] = {&Examination::examine_coordinates, &Examination::examine_lines,
                                 &Examination::examine_steps,       &Examination::examine_firings,
                                 &Examination::examine_duplicates,  &Examination::examine_order,
                                 &Examination::examine_ranges,      &Examination::examine_places,
                                 &Examination::examine_drift,       &Examination::examine_voids,
                                 &Examination::tally_flags,         &Examination::gather_regions};
    double done = 0.0;
    for (const Stage stage : kStages) {
      if (progress_) progress_(0.1 + 0.9 * done++ / std::size(kStages));
      (this->*stage)();
    }
    return std::move(result_);
  }

 private:
  EvidenceReport& report(Evidence evidence) { return result_.evidence[index_of(evidence)]; }
  bool dropped(Evidence evidence) { return report(evidence).dropped != Dropped::kNo; }

  // Drops `evidence` where the lattice does not know it or what it stands on was dropped.
  bool usable(Evidence evidence, bool known, std::initializer_list<Evidence> stands_on) {
    if (!known) report(evidence).dropped = Dropped::kUnknown;
    for (const Evidence basis : stands_on) {
      if (!dropped(evidence) && dropped(basis)) report(evidence).dropped = Dropped::kDepends;
    }
    return !dropped(evidence);
  }

  // Flags the points for which `contradicts(i)`, unless too many do.
  template <typename Predicate>
  void flag_points(Evidence evidence, const Predicate& contradicts) {
    std::vector<std::int32_t> found;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) >= 0 && contradicts(i)) found.push_back(i);
    }
    flag_points(evidence, found);
  }

  void flag_points(Evidence evidence, const std::vector<std::int32_t>& found) {
    if (is_dropped_by(evidence, found)) return;
    for (const std::int32_t i : found) flag(i, evidence);
  }

  // Reports the share of the points that contradict `evidence`, which is dropped if they are
  // everywhere.
  bool is_dropped_by(Evidence evidence, const std::vector<std::int32_t>& found) {
    const auto total = static_cast<double>(std::max<std::int64_t>(num_read_, 1));
    report(evidence).share = static_cast<double>(found.size()) / total;
    SectorTally contradicting{};
    for (const std::int32_t i : found) ++contradicting[sector(i)];
    const double spoiled = evidence == Evidence::kPlace ? kSpoiledPlaces : kSpoiledShare;
    const bool is_spoiled = is_everywhere(contradicting, spoiled);
    if (is_spoiled) report(evidence).dropped = Dropped::kContradicted;
    return is_spoiled;
  }

  // Whether the horizon holds a large share of such points, or more than half of its sectors hold
  // some: an edit is somewhere, what was done to the whole frame is everywhere.
  [[nodiscard]] bool is_everywhere(const SectorTally& contradicting, double least) const {
    const std::vector<double> shares = shares_of_sectors(contradicting);
    const auto spoiled =
        std::count_if(shares.begin(), shares.end(), [least](double s) { return s > least; });
    return mean(shares) > options_.dropped_share ||
           (shares.size() >= kFewestSectors && 2 * spoiled > std::ssize(shares));
  }

  // The shares of such points in the sectors that hold points, so that every direction counts the
  // same, however many points were pasted into one; a single share where few sectors hold points.
  [[nodiscard]] std::vector<double> shares_of_sectors(const SectorTally& found) const {
    std::vector<double> shares;
    for (std::size_t s = 0; s < kSectors; ++s) {
      if (sectors_[s] < kFewestOfSector) continue;
      shares.push_back(static_cast<double>(found[s]) / static_cast<double>(sectors_[s]));
    }
    if (shares.size() >= kFewestSectors) return shares;
    const auto all = std::accumulate(found.begin(), found.end(), std::int64_t{0});
    return {static_cast<double>(all) / static_cast<double>(std::max<std::int64_t>(num_read_, 1))};
  }

  static double mean(const std::vector<double>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  }

  [[nodiscard]] std::size_t sector(std::int32_t i) const {
    const auto s = static_cast<std::size_t>(reading_.azimuth(i) * (kSectors / kFullTurn));
    return std::min(s, kSectors - 1);
  }

  void flag(std::int32_t i, Evidence evidence) {
    result_.flags[i] |= static_cast<std::uint16_t>(1U << index_of(evidence));
  }

  void examine_coordinates() {
    const double step = lattice_.coordinate_step;
    if (!usable(Evidence::kGrid, step > 0.0, {})) return;
    const auto off = [&](std::int32_t i) {
      double most = 0.0;
      for (int axis = 0; axis < 3; ++axis) {
        const double value = points_.points(i, axis);
        most = std::max(most, std::abs(value - std::floor(value / step + 0.5) * step));
      }
      return most;
    };
    std::vector<std::int32_t> found;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) >= 0 && off(i) > kFloatRounding) found.push_back(i);
    }
    if (is_dropped_by(Evidence::kGrid, found)) return;
    for (const std::int32_t i : found) {
      if (off(i) > kFloatArithmetic) flag(i, Evidence::kGrid);
    }
  }

  void examine_lines() {
    flag_points(Evidence::kLine,
                [&](std::int32_t i) { return is_beside(i, reading_.line_error(i)); });
  }

  void examine_steps() {
    if (!usable(Evidence::kStep, lattice_.steps > 0, {Evidence::kLine})) return;
    flag_points(Evidence::kStep,
                [&](std::int32_t i) { return is_beside(i, reading_.step_error(i)); });
    forget_counts_beside_lattice();
  }

  // Angles of a line and of a step are known as well as the slope: from the same points.
  [[nodiscard]] bool is_beside(std::int32_t i, double error) const {
    const double off = std::abs(error) - options_.tolerance;
    if (off <= 0.0) return false;
    const Eigen::RowVector2d p = points_.points.row(i).head<2>().cast<double>();
    const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
    return !(off <= lattice_.rings[reading_.ring(i)].uncertainty(rho));
  }

  // Near the axis steps are shorter than what moved the points.
  void forget_uncertain_counts() {
    constexpr double kRounding = 0.0005 * 1.4142135623730951;  // of x and y to 1 mm
    const double least = 2.0 * (options_.azimuth_error + kRounding) / lattice_.azimuth_step;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      const Eigen::RowVector2d p = points_.points.row(i).head<2>().cast<double>();
      if (p.squaredNorm() < least * least) reading_.count(i) = -1;
    }
  }

  // A point between lines or steps is of no firing; it neither votes for one nor answers it.
  void forget_counts_beside_lattice() {
    constexpr unsigned kBeside =
        1U << static_cast<unsigned>(Evidence::kLine) | 1U << static_cast<unsigned>(Evidence::kStep);
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if ((result_.flags[i] & kBeside) != 0) reading_.count(i) = -1;
    }
  }

  void examine_firings() {
    if (!usable(Evidence::kFiring, lattice_.steps > 0, {Evidence::kLine, Evidence::kStep})) return;
    schedule_ = find_firings(reading_, lattice_);
    flag_points(Evidence::kFiring, [&](std::int32_t i) {
      const std::int32_t count = reading_.count(i);
      return count >= 0 && schedule_.judged[count] != 0 && schedule_.order[count] < 0;
    });
  }

  void examine_duplicates() {
    result_.num_directions = num_read_;
    if (!usable(Evidence::kDuplicate, lattice_.steps > 0, {Evidence::kLine, Evidence::kStep})) {
      return;
    }
    RingImage<std::uint8_t> returns(lattice_.num_rings(), lattice_.steps, 0);
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.count(i) < 0) continue;
      std::uint8_t& number = returns(reading_.ring(i), reading_.count(i));
      number = static_cast<std::uint8_t>(std::min(number + 1, 2));
    }
    const auto& seen = returns.values();
    result_.num_directions = std::count_if(seen.begin(), seen.end(), [](auto n) { return n > 0; });
    flag_points(Evidence::kDuplicate, [&](std::int32_t i) {
      return reading_.count(i) >= 0 && returns(reading_.ring(i), reading_.count(i)) > 1;
    });
  }

  void examine_order() {
    if (!usable(Evidence::kOrder, true, {Evidence::kLine})) return;
    flag_points(Evidence::kOrder, misplaced_in_file(reading_));
  }

  void examine_ranges() {
    if (!usable(Evidence::kRange, lattice_.range_step > 0.0, {Evidence::kLine})) return;
    const double quarter = 0.25 * lattice_.range_step;
    const auto incoherent = [&](std::int32_t i) {
      return std::abs(reading_.range_error(i)) > quarter;
    };
    std::vector<RangeTally> tallies(voxels_.size());
    SectorTally off_by_sector{};
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) < 0) continue;
      RangeTally& tally = tallies[voxel_of_point_[i]];
      const int off = incoherent(i) ? 1 : 0;
      ++tally.points;
      tally.incoherent += off;
      off_by_sector[sector(i)] += off;
    }
    const double share = mean(shares_of_sectors(off_by_sector));
    const double clean = options_.range_incoherence;
    report(Evidence::kRange).share = std::max(0.0, (share - clean) / (0.5 - clean));
    if (report(Evidence::kRange).share > options_.dropped_share) {
      report(Evidence::kRange).dropped = Dropped::kContradicted;
      return;
    }
    const auto windows = incoherent_windows(voxels_, tallies, clean, kWindowThreshold);
    if (std::none_of(windows.begin(), windows.end(), [](float e) { return e > 0.0F; })) return;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) < 0 || !incoherent(i)) continue;
      const float exponent = windows[voxel_of_point_[i]];
      if (!(exponent > 0.0F)) continue;
      flag(i, Evidence::kRange);
      const RangeVoxel& at = voxels_.voxels()[voxel_of_point_[i]];
      double& strength = cells_(at.row, at.column)[index_of(Evidence::kRange)];
      strength = std::max<double>(strength, exponent);
    }
  }

  // Who moves points along their beams and writes them again rounds twice, or to ranges between
  // those that the laser prints: many are not roundings of a place where it can have measured.
  void examine_places() {
    const double step = lattice_.coordinate_step;
    const bool known = lattice_.steps > 0 && lattice_.range_step > 0.0 && is_rounded_once();
    if (!usable(Evidence::kPlace, known,
                {Evidence::kGrid, Evidence::kLine, Evidence::kStep, Evidence::kRange})) {
      return;
    }
    const LatticePlaces places(lattice_);
    flag_points(Evidence::kPlace, [&](std::int32_t i) {
      if (reading_.count(i) < 0) return false;
      const Eigen::Vector3d point = points_.points.row(i).transpose().cast<double>();
      const double off = places.distance(point, reading_.ring(i), reading_.count(i));
      if (off <= 0.5 * step + kPlaceMargin) return false;
      const double rho = std::sqrt(point.x() * point.x() + point.y() * point.y());
      const double doubt = lattice_.rings[reading_.ring(i)].uncertainty(rho);
      return off > 0.5 * step + kPlaceMargin + doubt;
    });
  }

  // Whether coordinates are the scanner's own, rounded to their step and moved by nothing else.
  [[nodiscard]] bool is_rounded_once() const {
    const double step = lattice_.coordinate_step;
    return step > 0.0 && options_.tolerance <= 2.001 * step && options_.azimuth_error == 0.0;
  }

  struct DriftTally {
    std::int32_t points = 0;
    float error = 0.0F;  // metres, summed
    float doubt = 0.0F;  // what the line may be off, summed: all points of a laser share it
  };

  void examine_drift() {
    const double step = lattice_.coordinate_step;
    const bool known = step > 0.0 && options_.tolerance <= 2.001 * step;
    if (!usable(Evidence::kDrift, known, {Evidence::kLine, Evidence::kGrid})) return;
    const std::vector<float> deviations = drift_deviations(drift_tallies(), kRoundingShare * step);
    const auto drifts = [](float deviation) { return std::abs(deviation) > kDriftThreshold; };
    if (std::none_of(deviations.begin(), deviations.end(), drifts)) return;
    std::vector<std::int32_t> drifting;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (!is_near_line(i)) continue;
      const float deviation = deviations[voxel_of_point_[i]];
      if (!drifts(deviation)) continue;
      const RangeVoxel& at = voxels_.voxels()[voxel_of_point_[i]];
      double& strength = cells_(at.row, at.column)[index_of(Evidence::kDrift)];
      strength = std::max<double>(strength, std::abs(deviation));
      if ((reading_.line_error(i) > 0.0F) == (deviation > 0.0F)) drifting.push_back(i);
    }
    flag_points(Evidence::kDrift, drifting);
    if (!dropped(Evidence::kDrift)) return;
    report(Evidence::kDrift).dropped = Dropped::kUnknown;  // of another unit, about as this one
    for (int row = 0; row < cells_.rings(); ++row) {
      for (int column = 0; column < cells_.columns(); ++column) {
        cells_(row, column)[index_of(Evidence::kDrift)] = 0.0;
      }
    }
  }

  [[nodiscard]] bool is_near_line(std::int32_t i) const {
    return reading_.ring(i) >= 0 && std::abs(reading_.line_error(i)) < kDriftGate;
  }

  [[nodiscard]] RangeVoxel voxel_of(std::int32_t i) const {
    return {cell_row(i), cell_column(reading_.azimuth(i)),
            range_layer(points_.points.row(i).squaredNorm())};
  }

  // Errors by direction and distance, less the mean of each laser.
  [[nodiscard]] std::vector<DriftTally> drift_tallies() const {
    std::vector<std::int32_t> points(lattice_.rings.size(), 0);
    std::vector<double> means(lattice_.rings.size(), 0.0);
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (!is_near_line(i)) continue;
      ++points[reading_.ring(i)];
      means[reading_.ring(i)] += reading_.line_error(i);
    }
    for (std::size_t ring = 0; ring < means.size(); ++ring) {
      means[ring] /= std::max(points[ring], 1);
    }
    std::vector<DriftTally> tallies(voxels_.size());
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (!is_near_line(i)) continue;
      const auto ring = static_cast<std::size_t>(reading_.ring(i));
      const Eigen::RowVector2d p = points_.points.row(i).head<2>().cast<double>();
      DriftTally& tally = tallies[voxel_of_point_[i]];
      ++tally.points;
      tally.error += static_cast<float>(reading_.line_error(i) - means[ring]);
      // The lattice states 4 deviations.
      tally.doubt += static_cast<float>(
          0.25 * lattice_.rings[ring].uncertainty(std::sqrt(p.x() * p.x() + p.y() * p.y())));
    }
    return tallies;
  }

  // Deviations of the mean of the window around each voxel, in units of their common spread where
  // that is larger than rounding explains; 0 where few windows hold enough points.
  [[nodiscard]] std::vector<float> drift_deviations(const std::vector<DriftTally>& tallies,
                                                    double rounding) const {
    std::vector<float> deviations(voxels_.size(), 0.0F);
    std::vector<float> sizes;
    for (std::size_t k = 0; k < voxels_.size(); ++k) {
      if (tallies[k].points == 0) continue;
      const DriftTally sum = drift_window(tallies, voxels_.voxels()[k]);
      if (sum.points < kFewestDrifting) continue;
      const double doubt = sum.doubt;
      const double spread = std::sqrt(sum.points * rounding * rounding + doubt * doubt);
      deviations[k] = static_cast<float>(sum.error / spread);
      sizes.push_back(std::abs(deviations[k]));
    }
    const bool enough = sizes.size() >= kFewestDriftWindows;
    const double common = enough ? std::max(1.0, kNormalMad * median(std::span(sizes))) : 0.0;
    for (float& deviation : deviations) {
      deviation = enough ? static_cast<float>(deviation / common) : 0.0F;
    }
    return deviations;
  }

  [[nodiscard]] DriftTally drift_window(const std::vector<DriftTally>& tallies,
                                        const RangeVoxel& at) const {
    DriftTally sum;
    const int columns = voxels_.columns();
    for (int r = std::max(0, at.row - kDriftRows);
         r <= std::min(voxels_.rows() - 1, at.row + kDriftRows); ++r) {
      for (int d = -kDriftColumns; d <= kDriftColumns; ++d) {
        const int column = (at.column + d + columns) % columns;
        const auto [first, last] = voxels_.numbers(r, column, at.layer, at.layer);
        if (first == last) continue;
        const DriftTally& tally = tallies[first];
        sum.points += tally.points;
        sum.error += tally.error;
        sum.doubt += tally.doubt;
      }
    }
    return sum;
  }

  void examine_voids() {
    const bool known = lattice_.steps > 0;
    const auto basis = {Evidence::kLine, Evidence::kStep, Evidence::kFiring};
    if (!usable(Evidence::kTime, known, basis) || !usable(Evidence::kVoid, known, basis)) {
      report(Evidence::kVoid).dropped = report(Evidence::kTime).dropped;
      return;
    }
    const auto ground = find_ground_plane(points_);
    if (!ground) {
      report(Evidence::kVoid).dropped = Dropped::kNoGround;
      report(Evidence::kTime).dropped = Dropped::kNoGround;
      return;
    }
    const Answers answers = sort_answers(points_, reading_, lattice_, schedule_, *ground);
    VoidOptions options;
    options.min_ground_range = options_.min_ground_range;
    options.max_ground_range = options_.max_ground_range;
    options.progress = stage_progress();
    add_voids(Evidence::kVoid, find_voids(points_, answers, lattice_, *ground, options));

    std::vector<Answers> turns;
    for (const PointsView* turn : beside_) {
      if (auto answered = answers_of(*turn, *ground)) turns.push_back(std::move(*answered));
    }
    if (turns.empty()) {
      report(Evidence::kTime).dropped = Dropped::kNoPrevious;
      return;
    }
    for (const Answers& turn : turns) options.beside.push_back(&turn);
    result_.num_turns = static_cast<int>(turns.size());
    options.answered_beside = kAnsweredBesideInTime;
    add_voids(Evidence::kTime, find_voids(points_, answers, lattice_, *ground, options));
  }

  // The answers of another turn; none if it is not on the same lattice.
  [[nodiscard]] std::optional<Answers> answers_of(const PointsView& turn,
                                                  const GroundPlane& ground) const {
    if (turn.num_points() == 0) return std::nullopt;
    LatticeReading reading = read_lattice(turn, lattice_, options_.num_threads, stage_progress());
    std::int64_t off = 0;
    for (std::int32_t i = 0; i < turn.num_points(); ++i) {
      if (reading.ring(i) < 0) continue;
      const double error =
          std::max(std::abs(reading.line_error(i)), std::abs(reading.step_error(i)));
      if (error <= options_.tolerance) continue;
      reading.count(i) = -1;
      ++off;
    }
    const auto total = static_cast<double>(turn.num_points());
    if (static_cast<double>(off) > options_.dropped_share * total) return std::nullopt;
    const FiringSchedule schedule = find_firings(reading, lattice_);
    if (2 * schedule.firings < schedule_.firings) return std::nullopt;
    return sort_answers(turn, reading, lattice_, schedule, ground);
  }

  void add_voids(Evidence evidence, std::vector<Void> voids) {
    std::size_t firings = 0;
    for (const Void& found : voids) {
      firings += found.cells.size();
      for (const Void::Cell& cell : found.cells) {
        cells_(cell.ring / kCellRings, cell_column(cell.azimuth))[index_of(evidence)] +=
            found.weight;
      }
    }
    report(evidence).share =
        static_cast<double>(firings) / static_cast<double>(std::max<std::int64_t>(num_read_, 1));
    std::move(voids.begin(), voids.end(), std::back_inserter(voids_));
  }

  // Progress of the search for voids, the longest stage; it may cancel.
  [[nodiscard]] Progress stage_progress() const { return part_of(progress_, 0.8, 0.8); }

  [[nodiscard]] int cell_row(std::int32_t i) const { return reading_.ring(i) / kCellRings; }

  static int cell_column(double azimuth) {
    const auto column = static_cast<int>(azimuth * (kCellColumns / kFullTurn));
    return std::min(column, kCellColumns - 1);
  }

  void tally_flags() {
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      const unsigned flags = result_.flags[i];
      if (flags == 0) continue;
      Strength& cell = cells_(cell_row(i), cell_column(reading_.azimuth(i)));
      for (std::size_t e = 0; e < index_of(Evidence::kRange); ++e) cell[e] += flags >> e & 1U;
    }
  }

  void gather_regions() {
    RingImage<std::uint8_t> suspect(cells_.rings(), cells_.columns(), 0);
    for (int row = 0; row < cells_.rings(); ++row) {
      for (int column = 0; column < cells_.columns(); ++column) {
        double sum = 0.0;
        for (const double strength : cells_(row, column)) sum += strength;
        suspect(row, column) = sum > 0.0 ? 1 : 0;
        result_.cells.push_back(static_cast<std::uint16_t>(std::min(sum + 0.5, 65535.0)));
      }
    }
    RingImage<std::int32_t> region_of(cells_.rings(), cells_.columns(), -1);
    for (const auto& component : connected_components(suspect)) {
      const auto number = static_cast<std::int32_t>(result_.regions.size());
      result_.regions.push_back(region(component));
      for (const auto& [row, column] : component) region_of(row, column) = number;
    }
    forget_windows_beside_points(region_of);
    find_boxes(region_of);
    name_regions_of_points(region_of);
    for (const SuspectRegion& found : result_.regions) {
      for (std::size_t e = 0; e < kNumEvidence; ++e) {
        double& strength = result_.evidence[e].strength;
        strength = std::max(strength, found.strength[e]);
      }
    }
  }

  [[nodiscard]] SuspectRegion region(const std::vector<RingCell>& component) const {
    SuspectRegion found;
    found.lower.setConstant(std::numeric_limits<double>::infinity());
    found.upper = -found.lower;
    for (const auto& [row, column] : component) {
      const Strength& cell = cells_(row, column);
      for (std::size_t e = 0; e < kNumEvidence; ++e) {
        double& strength = found.strength[e];
        const bool is_window = e == index_of(Evidence::kRange) || e == index_of(Evidence::kDrift);
        strength = is_window ? std::max(strength, cell[e]) : strength + cell[e];
      }
    }
    return found;
  }

  void extend_box(std::int32_t region, const Eigen::Vector3d& point) {
    SuspectRegion& found = result_.regions[region];
    found.lower = found.lower.cwiseMin(point);
    found.upper = found.upper.cwiseMax(point);
  }

  // Windows reach beyond what was forged. Where single points are known to be, they say
  // better where.
  void forget_windows_beside_points(const RingImage<std::int32_t>& region_of) {
    constexpr auto kWindow = static_cast<std::uint16_t>(1U << index_of(Evidence::kRange) |
                                                        1U << index_of(Evidence::kDrift));
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      std::uint16_t& flags = result_.flags[i];
      if ((flags & kWindow) == 0) continue;
      const std::int32_t number = region_of(cell_row(i), cell_column(reading_.azimuth(i)));
      const Strength& strength = result_.regions[number].strength;
      const auto* windows = strength.data() + index_of(Evidence::kRange);
      if (std::any_of(strength.data(), windows, [](double s) { return s > 0.0; })) {
        flags &= static_cast<std::uint16_t>(~kWindow);
      }
    }
  }

  void find_boxes(const RingImage<std::int32_t>& region_of) {
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (result_.flags[i] == 0) continue;
      extend_box(region_of(cell_row(i), cell_column(reading_.azimuth(i))),
                 points_.points.row(i).transpose().cast<double>());
    }
    for (const Void& found : voids_) {
      for (const Void::Cell& cell : found.cells) {
        extend_box(region_of(cell.ring / kCellRings, cell_column(cell.azimuth)),
                   stood_at(cell, found.distance));
      }
    }
  }

  // A removed object stood on the ground, no nearer than the last returns below and not far behind.
  [[nodiscard]] Eigen::Vector3d stood_at(const Void::Cell& cell, double distance) const {
    const SinCos azimuth = sin_cos(cell.azimuth);
    return {distance * azimuth.cos, distance * azimuth.sin,
            lattice_.rings[cell.ring].slope * distance + lattice_.rings[cell.ring].offset};
  }

  void name_regions_of_points(const RingImage<std::int32_t>& region_of) {
    result_.region_of_point.assign(result_.flags.size(), -1);
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      const auto row = static_cast<std::size_t>(i);
      if (result_.flags[row] == 0) continue;
      result_.region_of_point[row] = region_of(cell_row(i), cell_column(reading_.azimuth(i)));
    }
  }

  const PointsView& points_;
  std::array<const PointsView*, 2> beside_;  // the turn before and the one behind
  const ScanLattice& lattice_;
  const GenericOptions& options_;
  const Progress& progress_;
  LatticeReading reading_;
  RingImage<Strength> cells_;
  RangeVoxels voxels_;
  std::vector<std::int32_t> voxel_of_point_;  // number; -1: the point was not read
  FiringSchedule schedule_;
  std::vector<Void> voids_;
  std::int64_t num_read_ = 0;
  SectorTally sectors_{};  // points that were read
  GenericResult result_;
};

void check_options(const GenericOptions& options) {
  if (!(options.tolerance > 0.0 && options.tolerance < 1.0)) {
    throw InputError("tolerance: expected metres in (0, 1), got " +
                     std::to_string(options.tolerance));
  }
  if (!(options.dropped_share > 0.0 && options.dropped_share <= 1.0)) {
    throw InputError("dropped_share: expected a share in (0, 1], got " +
                     std::to_string(options.dropped_share));
  }
  if (!(options.azimuth_error >= 0.0 && options.azimuth_error < 1.0)) {
    throw InputError("azimuth_error: expected 0 to 1 m, got " +
                     std::to_string(options.azimuth_error));
  }
  if (!(options.range_incoherence > 0.0 && options.range_incoherence < 0.5)) {
    throw InputError("range_incoherence: expected a share in (0, 0.5), got " +
                     std::to_string(options.range_incoherence));
  }
  if (!(options.min_ground_range > 0.0 && options.max_ground_range > options.min_ground_range)) {
    throw InputError("min_ground_range: expected 0 < min_ground_range < max_ground_range");
  }
}

}  // namespace

GenericResult generic_consistency(const PointsView& points, const ScanLattice& lattice,
                                  const GenericOptions& options, const PointsView& previous,
                                  const PointsView& following, const Progress& progress) {
  check_options(options);
  return Examination(
             points, lattice,
             read_lattice(points, lattice, options.num_threads, part_of(progress, 0.0, 0.1)),
             options, previous, following, progress)
      .run();
}

GenericResult generic_consistency(const PointsView& points, const ScanLattice& lattice,
                                  LatticeReading reading, const GenericOptions& options,
                                  const PointsView& previous, const PointsView& following,
                                  const Progress& progress) {
  check_options(options);
  check_reading(reading, points, lattice);
  return Examination(points, lattice, std::move(reading), options, previous, following, progress)
      .run();
}

}  // namespace manip3d
