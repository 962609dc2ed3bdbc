#include "manip3d/authenticate/generic.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>

#include "authenticate/drift_windows.hpp"
#include "authenticate/file_order.hpp"
#include "authenticate/ground_plane.hpp"
#include "authenticate/horizon_sectors.hpp"
#include "authenticate/lattice_places.hpp"
#include "authenticate/range_windows.hpp"
#include "authenticate/ring_image.hpp"
#include "authenticate/suspect_regions.hpp"
#include "authenticate/void_search.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

// Float32 holds a coordinate of 100 m to 4 micrometres.
constexpr double kFloatRounding = 1e-5;  // metres

// Errors of coordinates that were rotated and shifted by some 100 m in single precision and back:
// at most 33 micrometres in frames that are not changed as a whole by this. Random coordinates are
// as near to a step in all three axes for one point in a thousand.
constexpr double kFloatArithmetic = 5e-5;  // metres

// Natural logarithm of the improbability of a range window. The largest of a million clean windows
// exceeds this in at most 2 % of the frames.
constexpr double kWindowThreshold = 18.0;

// Metres by which a coordinate may be farther from its place on the lattice than by rounding. None
// of the 5.7 million points of 47 frames of KITTI, ten of which gave the lattice, needs more than
// 0.13 mm.
constexpr double kPlaceMargin = 0.00025;

// Standard deviations; clean windows of KITTI's frames reach 7.6.
constexpr double kDriftThreshold = 8.0;

// If each sector has at least this share of contradicting points, the frame as a whole was changed:
// rounding and resampling leave 2 stray points in 100. The limit for places is lower, because clean
// frames have no stray places, and cutting coordinates to whole millimetres by a product in single
// precision moves one in a hundred of them by a step.
constexpr double kSpoiledShare = 0.02;
constexpr double kSpoiledPlaces = 0.005;

// Returns beside a gap, of 8, that are enough if the previous turn had returns in the gap.
constexpr int kAnsweredBesideInTime = 6;

// The stages of the examination of one frame, in the order in which they depend on each other.
class Examination {
 public:
  Examination(const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
              const GenericOptions& options, const PointsView& previous,
              const PointsView& following, const Progress& progress)
      : points_(points),
        other_turns_{&previous, &following},
        lattice_(lattice),
        options_(options),
        progress_(progress),
        reading_(std::move(reading)),
        cells_((lattice.num_rings() + kCellRings - 1) / kCellRings, kCellColumns, Strength{}),
        voxels_(cells_.rings(), cells_.columns()),
        voxel_of_point_(points.num_points(), -1) {
    result_.flags.assign(points.num_points(), 0);
    for (std::int32_t i = 0; i < points.num_points(); ++i) {
      if (reading_.ring(i) < 0) continue;
      sectors_.add(reading_.azimuth(i));
      voxel_of_point_[i] = voxels_.add(voxel_of(i));
    }
    voxels_.number();
    for (std::int32_t& voxel : voxel_of_point_) {
      if (voxel >= 0) voxel = voxels_.number_at(voxel);
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
                                 &Examination::tally_flags,         &Examination::find_regions};
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

  // Can `evidence` be used? Drops it if the lattice does not have the property (`known`), or if
  // evidence that it depends on was dropped.
  bool usable(Evidence evidence, bool known, std::initializer_list<Evidence> stands_on) {
    if (!known) report(evidence).dropped = Dropped::kUnknown;
    for (const Evidence basis : stands_on) {
      if (!dropped(evidence) && dropped(basis)) report(evidence).dropped = Dropped::kDepends;
    }
    return !dropped(evidence);
  }

  // Flags the points for which `contradicts(i)` holds, unless there are too many of them.
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

  // Reports the share of points that contradict the lattice. Drops `evidence` if they are
  // everywhere.
  bool is_dropped_by(Evidence evidence, const std::vector<std::int32_t>& found) {
    report(evidence).share = share_of_read(found.size());
    HorizonSectors::Tally contradicting{};
    for (const std::int32_t i : found) ++contradicting[HorizonSectors::sector(reading_.azimuth(i))];
    const double spoiled = evidence == Evidence::kPlace ? kSpoiledPlaces : kSpoiledShare;
    const bool is_spoiled = sectors_.is_everywhere(contradicting, spoiled, options_.dropped_share);
    if (is_spoiled) report(evidence).dropped = Dropped::kContradicted;
    return is_spoiled;
  }

  [[nodiscard]] double share_of_read(std::size_t number) const {
    const auto total = static_cast<double>(std::max<std::int64_t>(sectors_.num_points(), 1));
    return static_cast<double>(number) / total;
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
    flag_points(Evidence::kLine, [&](std::int32_t i) { return is_off(i, reading_.line_error(i)); });
  }

  void examine_steps() {
    if (!usable(Evidence::kStep, lattice_.steps > 0, {Evidence::kLine})) return;
    flag_points(Evidence::kStep, [&](std::int32_t i) { return is_off(i, reading_.step_error(i)); });
    forget_counts_off_lattice();
  }

  // Is the error larger than the tolerance plus the uncertainty of the lattice? Azimuths of lines
  // and steps are as uncertain as slopes, because they were estimated from the same points.
  [[nodiscard]] bool is_off(std::int32_t i, double error) const {
    const double off = std::abs(error) - options_.tolerance;
    if (off <= 0.0) return false;
    const Eigen::RowVector2d p = points_.points.row(i).head<2>().cast<double>();
    const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
    return !(off <= lattice_.rings[reading_.ring(i)].uncertainty(rho));
  }

  // Near the axis, steps are shorter than the possible motion of points: their counts are unknown.
  void forget_uncertain_counts() {
    constexpr double kRounding = 0.0005 * 1.4142135623730951;  // of x and y to 1 mm
    const double least = 2.0 * (options_.azimuth_error + kRounding) / lattice_.azimuth_step;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      const Eigen::RowVector2d p = points_.points.row(i).head<2>().cast<double>();
      if (p.squaredNorm() < least * least) reading_.count(i) = -1;
    }
  }

  // A point between lines or steps belongs to no firing; it is neither a vote for one nor its
  // return.
  void forget_counts_off_lattice() {
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (is_flagged_off(i)) reading_.count(i) = -1;
    }
  }

  [[nodiscard]] bool is_flagged_off(std::int32_t i) const {
    constexpr unsigned kOff =
        1U << static_cast<unsigned>(Evidence::kLine) | 1U << static_cast<unsigned>(Evidence::kStep);
    return (result_.flags[i] & kOff) != 0;
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
    result_.num_directions = sectors_.num_points();
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
    flag_points(Evidence::kOrder, misplaced_in_file(reading_, lattice_.azimuth_step));
  }

  void examine_ranges() {
    if (!usable(Evidence::kRange, lattice_.range_step > 0.0, {Evidence::kLine})) return;
    const double quarter = 0.25 * lattice_.range_step;
    const auto incoherent = [&](std::int32_t i) {
      return std::abs(reading_.range_error(i)) > quarter;
    };
    std::vector<RangeTally> tallies(voxels_.size());
    HorizonSectors::Tally off_by_sector{};
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) < 0) continue;
      const int off = incoherent(i) ? 1 : 0;
      off_by_sector[HorizonSectors::sector(reading_.azimuth(i))] += off;
      // Points off lines or steps are evidence already. In a window they would accuse the few
      // clean ranges around them that are incoherent.
      if (is_flagged_off(i)) continue;
      RangeTally& tally = tallies[voxel_of_point_[i]];
      ++tally.points;
      tally.incoherent += off;
    }
    const double share = sectors_.share(off_by_sector);
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

  // An attacker who moves points along their beams rounds them twice, or creates ranges between the
  // range steps. In both cases many of them are not the rounding of any point that the laser can
  // measure.
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

  // Is the tolerance that of coordinates rounded to the lattice's step? Rounding moves a point by
  // up to 0.87 steps, and the tolerance is twice the step; the thousandth is for its own rounding.
  [[nodiscard]] bool tolerates_only_rounding() const {
    constexpr double kSteps = 2.001;
    const double step = lattice_.coordinate_step;
    return step > 0.0 && options_.tolerance <= kSteps * step;
  }

  // Are the coordinates the scanner's own, rounded to their step and otherwise unchanged?
  [[nodiscard]] bool is_rounded_once() const {
    return tolerates_only_rounding() && options_.azimuth_error == 0.0;
  }

  void examine_drift() {
    if (!usable(Evidence::kDrift, tolerates_only_rounding(), {Evidence::kLine, Evidence::kGrid}))
      return;
    const std::vector<double> means = mean_line_errors(reading_, lattice_.rings.size());
    const std::vector<float> deviations =
        drift_deviations(points_, reading_, lattice_, voxels_, voxel_of_point_, means);
    const auto drifts = [](float deviation) { return std::abs(deviation) > kDriftThreshold; };
    if (std::none_of(deviations.begin(), deviations.end(), drifts)) return;
    std::vector<std::int32_t> drifting;
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      if (!is_near_line(reading_, i)) continue;
      const float deviation = deviations[voxel_of_point_[i]];
      if (!drifts(deviation)) continue;
      const double error = reading_.line_error(i) - means[reading_.ring(i)];
      if ((error > 0.0) != (deviation > 0.0F)) continue;
      drifting.push_back(i);
      const RangeVoxel& at = voxels_.voxels()[voxel_of_point_[i]];
      double& strength = cells_(at.row, at.column)[index_of(Evidence::kDrift)];
      strength = std::max<double>(strength, std::abs(deviation));
    }
    flag_points(Evidence::kDrift, drifting);
    if (!dropped(Evidence::kDrift)) return;
    // the frame was processed as a whole, in a unit close to the lattice's
    report(Evidence::kDrift).dropped = Dropped::kUnknown;
    for (int row = 0; row < cells_.rings(); ++row) {
      for (int column = 0; column < cells_.columns(); ++column) {
        cells_(row, column)[index_of(Evidence::kDrift)] = 0.0;
      }
    }
  }

  [[nodiscard]] RangeVoxel voxel_of(std::int32_t i) const {
    return {cell_row(reading_.ring(i)), cell_column(reading_.azimuth(i)),
            range_layer(points_.points.row(i).squaredNorm())};
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
    for (const PointsView* turn : other_turns_) {
      if (auto answered = answers_of(*turn, *ground)) turns.push_back(std::move(*answered));
    }
    if (turns.empty()) {
      report(Evidence::kTime).dropped = Dropped::kNoPrevious;
      return;
    }
    for (const Answers& turn : turns) options.other_turns.push_back(&turn);
    result_.num_turns = static_cast<int>(turns.size());
    options.answered_beside = kAnsweredBesideInTime;
    add_voids(Evidence::kTime, find_voids(points_, answers, lattice_, *ground, options));
  }

  // Returns of another turn; none if the turn is empty or not on this lattice.
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
        cells_(cell_row(cell.ring), cell_column(cell.azimuth))[index_of(evidence)] += found.weight;
      }
    }
    report(evidence).share = share_of_read(firings);
    std::move(voids.begin(), voids.end(), std::back_inserter(voids_));
  }

  // Progress of the search for voids, the longest stage; the callback may cancel it.
  [[nodiscard]] Progress stage_progress() const { return part_of(progress_, 0.8, 0.8); }

  void tally_flags() {
    for (std::int32_t i = 0; i < points_.num_points(); ++i) {
      const unsigned flags = result_.flags[i];
      if (flags == 0) continue;
      Strength& cell = cells_(cell_row(reading_.ring(i)), cell_column(reading_.azimuth(i)));
      for (std::size_t e = 0; e < index_of(Evidence::kRange); ++e) cell[e] += flags >> e & 1U;
    }
  }

  void find_regions() { gather_regions(points_, lattice_, reading_, cells_, voids_, result_); }

  const PointsView& points_;
  std::array<const PointsView*, 2> other_turns_;  // previous and following
  const ScanLattice& lattice_;
  const GenericOptions& options_;
  const Progress& progress_;
  LatticeReading reading_;
  EvidenceCells cells_;
  RangeVoxels voxels_;
  std::vector<std::int32_t>
      voxel_of_point_;  // number of the voxel; -1: the point is off the lattice
  FiringSchedule schedule_;
  std::vector<Void> voids_;
  HorizonSectors sectors_;  // sectors of the points on the lattice
  GenericResult result_;
};

void check_options(const GenericOptions& options) {
  if (!(options.tolerance > 0.0 && options.tolerance < 1.0)) {
    throw InputError("tolerance: expected metres in (0, 1), got " + number_text(options.tolerance));
  }
  if (!(options.dropped_share > 0.0 && options.dropped_share <= 1.0)) {
    throw InputError("dropped_share: expected a share in (0, 1], got " +
                     number_text(options.dropped_share));
  }
  if (!(options.azimuth_error >= 0.0 && options.azimuth_error < 1.0)) {
    throw InputError("azimuth_error: expected 0 to 1 m, got " + number_text(options.azimuth_error));
  }
  if (!(options.range_incoherence > 0.0 && options.range_incoherence < 0.5)) {
    throw InputError("range_incoherence: expected a share in (0, 0.5), got " +
                     number_text(options.range_incoherence));
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
