#include "manip3d/authenticate/turns.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <string>
#include <utility>

#include "authenticate/ground_plane.hpp"
#include "authenticate/ring_image.hpp"
#include "geometry/constants.hpp"
#include "geometry/median.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

// Seconds: the turn for which the limits below and the thresholds of _turns.py were chosen.
// Scanners turn 5 to 20 times a second. Turns that are up to one and a half of these apart are
// compared, too (MAX_APART_NS), with the same limits: the facade refuses a scanner that moved
// farther than 1.4 m (FARTHEST_MOTION), which is well within those of the guess, and a wider
// kMovedColumns would excuse more of the edits in all scans for the few things that pass that fast.
constexpr double kTurnSeconds = 0.1;

// The motion during a turn, rounded to whole units.
constexpr int in_a_turn(double per_second, double unit) {
  return static_cast<int>(per_second * kTurnSeconds / unit + 0.5);
}

constexpr float kNothingNear = kInfinityF;

// Radians: no laser could have measured a point that is farther than this from every line, since
// lines are 6 to 9 mrad apart.
constexpr double kOffLines = 0.0045;

// A turn saw something solid in a direction if at least this many of the direction and the eight
// around it have points.
constexpr int kSolidPoints = 4;
// A laser with returns in fewer directions than this was left out of the frame, so that missing
// returns prove nothing. The lasers of KITTI's whole frames have returns in two fifths of the
// directions or more.
constexpr int kMinAnswered = kTurnColumns / 50;

// Regions consist of blocks of this many directions. Edges of objects, which cause false evidence,
// are only one or two directions wide.
constexpr int kTurnBlockRings = 2;
constexpr int kTurnBlockColumns = 3;
constexpr std::int64_t kMinDirections = 6;

// The largest motion of a passing object from turn to turn: directions (93 degrees per second, 26
// m/s at a distance of 16 m) and lasers.
constexpr int kMovedColumns = in_a_turn(93.0, 360.0 / kTurnColumns);
constexpr int kMovedRings = 2;

// Ranges of a turn, by direction.
struct TurnView {
  // metres: smallest and largest range in the direction and the eight around it
  RingImage<float> near, far;
  RingImage<std::int32_t> points;  // number of points in the nine directions
  RingImage<std::uint8_t> full;    // 1: each of the nine directions has points
};

// The points of a scan that lie near the line of a laser, with their directions.
class Directed {
 public:
  Directed(const PointsView& points, LatticeReading reading)
      : points_(points), reading_(std::move(reading)) {}

  [[nodiscard]] LatticeReading take_reading() { return std::move(reading_); }

  template <typename Visitor>
  void each(const Visitor& visit) const {
    for (Eigen::Index i = 0; i < points_.num_points(); ++i) {
      if (reading_.ring(i) < 0) continue;
      const float range = points_.points.row(i).norm();
      if (!(std::abs(reading_.line_error(i)) < kOffLines * range)) continue;
      visit(i, reading_.ring(i), azimuth_column(reading_.azimuth(i), kTurnColumns), range);
    }
  }

 private:
  const PointsView& points_;
  LatticeReading reading_;
};

TurnView single_view(const Directed& directed, int rings) {
  TurnView view{{rings, kTurnColumns, kNothingNear},
                {rings, kTurnColumns, -kNothingNear},
                {rings, kTurnColumns, 0},
                {rings, kTurnColumns, 0}};
  directed.each([&](Eigen::Index, int ring, int column, float range) {
    view.near(ring, column) = std::min(view.near(ring, column), range);
    view.far(ring, column) = std::max(view.far(ring, column), range);
    ++view.points(ring, column);
    view.full(ring, column) = 1;
  });
  return view;
}

// Extends a view to the eight directions around each. Another turn has another viewpoint, so that
// its points can miss the exact direction.
TurnView spread_view(const TurnView& view) {
  TurnView spread = view;
  for (int ring = 0; ring < view.near.rings(); ++ring) {
    for (int column = 0; column < kTurnColumns; ++column) {
      float near = kNothingNear;
      float far = -kNothingNear;
      std::int32_t points = 0;
      std::uint8_t full = 1;
      for (int r = std::max(0, ring - 1); r <= std::min(view.near.rings() - 1, ring + 1); ++r) {
        for (int d = -1; d <= 1; ++d) {
          const int c = view.near.wrapped(column + d);
          near = std::min(near, view.near(r, c));
          far = std::max(far, view.far(r, c));
          points += view.points(r, c);
          full &= view.full(r, c);
        }
      }
      spread.near(ring, column) = near;
      spread.far(ring, column) = far;
      spread.points(ring, column) = points;
      spread.full(ring, column) = full;
    }
  }
  return spread;
}

// Rows without a return stay at the origin.
Points moved_points(const PointsView& view, const ScanMotion& motion) {
  const Eigen::Matrix3f turn = motion.rotation.cast<float>();
  const Eigen::RowVector3f shift = motion.translation.transpose().cast<float>();
  Points points = Points::Zero(view.num_points(), 3);
  for (Eigen::Index i = 0; i < view.num_points(); ++i) {
    const Eigen::RowVector3f p = view.points.row(i);
    if (is_no_return(p.x(), p.y(), p.z())) continue;
    const Eigen::RowVector3f moved = (turn * p.transpose()).transpose() + shift;
    if (moved.allFinite()) points.row(i) = moved;  // else no scanner sees so far
  }
  return points;
}

// The extent of a turn's points. Missing returns beyond it prove nothing.
struct TurnExtent {
  Eigen::AlignedBox3f box;
  float range = 0.0F;  // metres

  TurnExtent() = default;
  explicit TurnExtent(const Points& points) {
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      box.extend(points.row(i).transpose());
      range = std::max(range, points.row(i).norm());
    }
  }

  [[nodiscard]] bool holds(const Eigen::Vector3f& p) const {
    return box.contains(p) && p.norm() <= range;
  }
};

PointsView view_of(const Points& points) {
  return PointsView(PointsView::Map<Points>(points.data(), points.rows(), 3));
}

// The first guess of a motion: objects above the ground, on a grid seen from above, are shifted and
// rotated until most of them meet the objects of the other turn.
constexpr double kGuessCell = 0.25;                       // metres
constexpr double kGuessReach = 40.0;                      // metres
constexpr double kCarRadius = 4.0;                        // metres; the scanner's own vehicle
constexpr double kGuessHeight = 0.5, kGuessTop = 2.5;     // metres above the ground
constexpr int kGuessAhead = in_a_turn(40.0, kGuessCell);  // cells; 40 m/s are 144 km/h
constexpr int kGuessAside = in_a_turn(5.0, kGuessCell);
constexpr int kGuessTurns = in_a_turn(40.0, 1.0);  // degrees
constexpr std::size_t kGuessPoints = 1000;

class SeenFromAbove {
 public:
  SeenFromAbove(const PointsView& points, const GroundPlane& ground)
      : occupied_(static_cast<std::size_t>(kSide) * kSide, 0) {
    for (const Eigen::Vector2d& p : standing(points, ground)) {
      const Cell cell = cell_of(p);
      if (is_in_reach(cell)) occupied_[place_of(cell)] = 1;
    }
  }

  static std::vector<Eigen::Vector2d> standing(const PointsView& points,
                                               const GroundPlane& ground) {
    std::vector<Eigen::Vector2d> found;
    for (Eigen::Index i = 0; i < points.num_points(); ++i) {
      const Eigen::RowVector3d p = points.points.row(i).cast<double>();
      if (!(std::abs(p.x()) < kGuessReach && std::abs(p.y()) < kGuessReach)) continue;
      if (p.x() * p.x() + p.y() * p.y() < kCarRadius * kCarRadius) continue;
      const double height = ground.above(p.x(), p.y(), p.z());
      if (height > kGuessHeight && height < kGuessTop) found.emplace_back(p.x(), p.y());
    }
    return found;
  }

  // The motion by which most points meet the objects; of several, the smallest one, and of these
  // the first one. It is the identity if nothing stands above the ground.
  [[nodiscard]] ScanMotion best_motion(const PointsView& source, const GroundPlane& ground) const {
    const std::vector<Eigen::Vector2d> all = standing(source, ground);
    const std::size_t stride = std::max<std::size_t>(1, all.size() / kGuessPoints);
    ScanMotion best;
    std::pair<int, int> most{-1, 0};  // points that meet, and minus the size of the motion
    for (int degrees = -kGuessTurns; degrees <= kGuessTurns; ++degrees) {
      const SinCos turn = sin_cos(degrees * (kFullTurn / 360.0));
      std::vector<Cell> turned;
      for (std::size_t k = 0; k < all.size(); k += stride) {
        turned.push_back(cell_of({turn.cos * all[k].x() - turn.sin * all[k].y(),
                                  turn.sin * all[k].x() + turn.cos * all[k].y()}));
      }
      const Met met = num_met(turned);
      for (int ahead = -kGuessAhead; ahead <= kGuessAhead; ++ahead) {
        for (int aside = -kGuessAside; aside <= kGuessAside; ++aside) {
          const std::pair here{met[aside + kGuessAside][ahead + kGuessAhead],
                               -size_of(degrees, ahead, aside)};
          if (here <= most) continue;
          most = here;
          best.rotation << turn.cos, -turn.sin, 0.0, turn.sin, turn.cos, 0.0, 0.0, 0.0, 1.0;
          best.translation = {ahead * kGuessCell, aside * kGuessCell, 0.0};
        }
      }
    }
    return best;
  }

 private:
  static constexpr int kCells = static_cast<int>(2.0 * kGuessReach / kGuessCell);
  // Empty cells around those in reach, so that points near the border can be shifted as well.
  static constexpr int kMargin = 2 * std::max(kGuessAhead, kGuessAside);
  static constexpr int kSide = kCells + 2 * kMargin;
  static constexpr int kShifts = 2 * kGuessAhead + 1;

  struct Cell {
    int row, column;
  };
  // Number of points that meet occupied cells, by shift aside and ahead in cells.
  using Met = std::array<std::array<std::int32_t, kShifts>, 2 * kGuessAside + 1>;

  // The square of a motion's size, cells^2. In the middle of the reach a degree moves by 0.35 m,
  // which is about a cell.
  static int size_of(int degrees, int ahead, int aside) {
    return degrees * degrees + ahead * ahead + aside * aside;
  }

  static Cell cell_of(const Eigen::Vector2d& p) {
    return {static_cast<int>(std::floor((p.y() + kGuessReach) / kGuessCell)),
            static_cast<int>(std::floor((p.x() + kGuessReach) / kGuessCell))};
  }

  static bool is_in_reach(const Cell& cell) {
    return cell.row >= 0 && cell.row < kCells && cell.column >= 0 && cell.column < kCells;
  }

  // Index of a cell that is in reach, or outside by half the margin at most.
  static std::size_t place_of(const Cell& cell) {
    return static_cast<std::size_t>(cell.row + kMargin) * kSide + cell.column + kMargin;
  }

  // Counts the points that meet occupied cells for all shifts by whole cells; those ahead are
  // adjacent in memory.
  [[nodiscard]] Met num_met(const std::vector<Cell>& cells) const {
    constexpr int kHalf = kMargin / 2;
    Met met{};
    for (const Cell& cell : cells) {
      if (cell.row < -kHalf || cell.row >= kCells + kHalf) continue;
      if (cell.column < -kHalf || cell.column >= kCells + kHalf) continue;
      for (int aside = -kGuessAside; aside <= kGuessAside; ++aside) {
        const std::uint8_t* const first =
            occupied_.data() + place_of({cell.row + aside, cell.column - kGuessAhead});
        auto& run = met[aside + kGuessAside];
        for (int k = 0; k < kShifts; ++k) run[k] += first[k];
      }
    }
    return met;
  }

  std::vector<std::uint8_t> occupied_;
};

// Did the scanner move by about the same step before and after the frame?
bool goes_on(const ScanMotion& previous, const ScanMotion& following) {
  // Metres: braking changes the step of kTurnSeconds by 0.1, a wrong alignment changes it by more.
  constexpr double kMaxChange = 0.3;
  const Eigen::Vector3d there_and_on =
      previous.rotation * following.translation + previous.translation;
  return there_and_on.norm() < kMaxChange;
}

class TurnComparison {
 public:
  TurnComparison(const PointsView& points, const ScanLattice& lattice, LatticeReading reading,
                 const GroundPlane& ground, const TurnOptions& options,
                 const std::array<Points, 2>& turns, const Progress& progress)
      : lattice_(lattice),
        ground_(ground),
        options_(options),
        directed_(points, std::move(reading)),
        now_(single_view(directed_, lattice.num_rings())),
        turns_(turns),
        views_{view_of(turns[0]), view_of(turns[1])},
        others_{
            Directed(views_[0], read_lattice(views_[0], lattice, options.num_threads, progress)),
            Directed(views_[1], read_lattice(views_[1], lattice, options.num_threads, progress))},
        before_(spread_view(single_view(others_[0], lattice.num_rings()))),
        after_(spread_view(single_view(others_[1], lattice.num_rings()))),
        extents_{extent(turns[0]), extent(turns[1])} {}
  TurnComparison(const TurnComparison&) = delete;  // others_ refers to views_
  TurnComparison& operator=(const TurnComparison&) = delete;
  ~TurnComparison() = default;

  std::vector<TurnRegion> run() {
    std::array<RingImage<std::uint8_t>, kNumTurnEvidence> images{blank(), blank(), blank()};
    for (int ring = 0; ring < lattice_.num_rings(); ++ring) {
      if (num_answered(ring) < kMinAnswered) continue;
      for (int column = 0; column < kTurnColumns; ++column) {
        const Evidence found = evidence_at(ring, column);
        const auto mark = [&](TurnEvidence kind, bool is_there) {
          images[static_cast<std::size_t>(kind)](ring, column) = is_there ? 1 : 0;
        };
        mark(TurnEvidence::kLost, found.lost);
        mark(TurnEvidence::kThrough, found.through);
        mark(TurnEvidence::kBefore, found.before);
      }
    }
    std::vector<TurnRegion> regions;
    for (int kind = 0; kind < kNumTurnEvidence; ++kind) {
      add_regions(static_cast<TurnEvidence>(kind), images[kind], regions);
    }
    return regions;
  }

  std::array<LatticeReading, 2> take_readings() {
    return {others_[0].take_reading(), others_[1].take_reading()};
  }

 private:
  /// The kinds of evidence in a direction.
  struct Evidence {
    bool lost = false, through = false, before = false;
  };

  [[nodiscard]] TurnExtent extent(const Points& turn) const {
    return options_.whole_turns ? TurnExtent() : TurnExtent(turn);
  }

  [[nodiscard]] RingImage<std::uint8_t> blank() const {
    return {lattice_.num_rings(), kTurnColumns, 0};
  }

  // Number of directions in which a laser of the frame has points.
  [[nodiscard]] int num_answered(int ring) const {
    int answered = 0;
    for (int column = 0; column < kTurnColumns; ++column) {
      answered += now_.points(ring, column) > 0 ? 1 : 0;
    }
    return answered;
  }

  [[nodiscard]] float nearest_seen(int ring, int column) const {
    return std::min(before_.near(ring, column), after_.near(ring, column));
  }
  [[nodiscard]] float farthest_seen(int ring, int column) const {
    return std::max(before_.far(ring, column), after_.far(ring, column));
  }

  [[nodiscard]] double slack(double range) const {
    return options_.tolerance + options_.tolerance_share * range;
  }

  // Did both turns see something at the same distance?
  [[nodiscard]] bool agree(int ring, int column) const {
    const float a = before_.near(ring, column);
    const float b = after_.near(ring, column);
    return a < kNothingNear && b < kNothingNear &&
           std::abs(a - b) < slack(farthest_seen(ring, column));
  }

  // The place that a laser sees at a range.
  [[nodiscard]] Eigen::Vector3d place(int ring, int column, double range) const {
    const ScanLattice::Ring& laser = lattice_.rings[ring];
    const double cosine = 1.0 / std::sqrt(1.0 + laser.slope * laser.slope);
    const double rho = range * cosine;
    const double z = laser.slope * rho + laser.offset;
    const SinCos azimuth = sin_cos(kFullTurn * (column + 0.5) / kTurnColumns);
    return {rho * azimuth.cos, rho * azimuth.sin, z};
  }

  // Is the place that a laser sees at a range above the ground?
  [[nodiscard]] bool is_above(int ring, int column, double range) const {
    const Eigen::Vector3d p = place(ring, column, range);
    return ground_.above(p.x(), p.y(), p.z()) > options_.height;
  }

  // Do both turns have returns in all directions around this one? Always true for whole turns.
  [[nodiscard]] bool are_full(int ring, int column) const {
    return options_.whole_turns ||
           (before_.full(ring, column) != 0 && after_.full(ring, column) != 0);
  }

  [[nodiscard]] Evidence evidence_at(int ring, int column) const {
    Evidence found;
    const double near = nearest_seen(ring, column);
    if (!(near < kNothingNear)) return found;
    const double far = farthest_seen(ring, column);
    const bool both = before_.points(ring, column) > 0 && after_.points(ring, column) > 0;
    if (!both) return found;
    const bool in_reach = near > options_.nearest && near < options_.farthest;
    const bool solid =
        std::min(before_.points(ring, column), after_.points(ring, column)) >= kSolidPoints;
    const bool answered = now_.points(ring, column) > 0;
    found.lost = !answered && solid && in_reach;
    if (!answered) return found;
    // One surface in all nine directions of both turns. At an edge the turns also saw what is
    // behind it.
    const bool one_surface = far - near < slack(far);
    const bool full = are_full(ring, column);
    found.through = full && in_reach && one_surface && is_above(ring, column, near) &&
                    now_.near(ring, column) > far + slack(far);
    const double here = now_.far(ring, column);
    found.before = full && here > options_.nearest && here < options_.farthest &&
                   is_above(ring, column, here) && near > here + slack(here);
    return found;
  }

  void add_regions(TurnEvidence kind, const RingImage<std::uint8_t>& image,
                   std::vector<TurnRegion>& regions) const {
    const std::size_t first = regions.size();
    RingImage<std::int32_t> region_of(image.rings(), image.columns(), -1);
    Ticker no_ticker{Progress{}};  // an image is small
    const auto whole_blocks = opened(image, kTurnBlockRings, kTurnBlockColumns, no_ticker);
    for (const auto& component : connected_components(whole_blocks)) {
      if (static_cast<std::int64_t>(component.size()) < kMinDirections) continue;
      for (const auto& [ring, column] : component) {
        region_of(ring, column) = static_cast<std::int32_t>(regions.size());
      }
      regions.push_back(region(kind, component));
      regions.back().moved = moved_beside(kind, component);
    }
    if (regions.size() > first) name_points(kind, region_of, regions);
  }

  [[nodiscard]] TurnRegion region(TurnEvidence kind, const std::vector<RingCell>& component) const {
    TurnRegion found;
    found.kind = kind;
    found.cells = static_cast<std::int64_t>(component.size());
    std::vector<double> distances;
    for (const auto& [ring, column] : component) {
      const double range =
          kind == TurnEvidence::kBefore ? now_.far(ring, column) : nearest_seen(ring, column);
      const bool above = is_above(ring, column, range);
      found.ground += above ? 0 : 1;
      found.agreed += above && agree(ring, column) ? 1 : 0;
      distances.push_back(range);
    }
    found.distance = median(std::span(distances));
    return found;
  }

  // Number of directions near a region in which a turn has the same evidence and the frame has not:
  // a moving object leaves a hole, or a place that is seen through, near its new place.
  [[nodiscard]] std::int64_t moved_beside(TurnEvidence kind,
                                          const std::vector<RingCell>& component) const {
    int top = lattice_.num_rings();
    int bottom = 0;
    std::vector<std::uint8_t> around(kTurnColumns, 0);
    for (const auto& [ring, column] : component) {
      top = std::min(top, ring - kMovedRings);
      bottom = std::max(bottom, ring + kMovedRings);
      for (int d = -kMovedColumns; d <= kMovedColumns; ++d) {
        around[now_.points.wrapped(column + d)] = 1;
      }
    }
    top = std::max(top, 0);
    bottom = std::min(bottom, lattice_.num_rings() - 1);
    std::int64_t before = 0;
    std::int64_t after = 0;
    for (int column = 0; column < kTurnColumns; ++column) {
      if (around[column] == 0) continue;
      for (int ring = top; ring <= bottom; ++ring) {
        if (now_.points(ring, column) == 0) continue;
        before += gone(kind, before_, extents_[0], ring, column) ? 1 : 0;
        after += gone(kind, after_, extents_[1], ring, column) ? 1 : 0;
      }
    }
    return std::max(before, after);
  }

  // Does a turn have this kind of evidence in a direction, where the frame does not?
  [[nodiscard]] bool gone(TurnEvidence kind, const TurnView& turn, const TurnExtent& extent,
                          int ring, int column) const {
    const double here = now_.near(ring, column);
    if (kind == TurnEvidence::kLost) {
      return turn.points(ring, column) == 0 &&
             (options_.whole_turns || extent.holds(place(ring, column, here).cast<float>()));
    }
    if (kind == TurnEvidence::kBefore) {
      const double there = turn.far(ring, column);
      return there > options_.nearest && here > there + slack(there) &&
             is_above(ring, column, there);
    }
    return here < options_.farthest && turn.near(ring, column) > here + slack(here) &&
           turn.near(ring, column) < kNothingNear && is_above(ring, column, here);
  }

  // Adds to the regions the frame's points in them, and what the previous turn saw there.
  void name_points(TurnEvidence kind, const RingImage<std::int32_t>& region_of,
                   std::vector<TurnRegion>& regions) const {
    directed_.each([&](Eigen::Index i, int ring, int column, float) {
      const std::int32_t number = region_of(ring, column);
      if (number >= 0) {
        regions[number].rows.push_back(static_cast<std::int32_t>(i));
      }
    });
    if (kind == TurnEvidence::kBefore) return;
    std::vector<std::vector<Eigen::Index>> seen(regions.size());
    others_[0].each([&](Eigen::Index i, int ring, int column, float range) {
      const std::int32_t number = region_of(ring, column);
      if (number >= 0 && range < nearest_seen(ring, column) + slack(range)) {
        seen[number].push_back(i);
      }
    });
    for (std::size_t k = 0; k < regions.size(); ++k) {
      if (regions[k].kind != kind) continue;
      regions[k].stood.resize(static_cast<Eigen::Index>(seen[k].size()), 3);
      for (std::size_t j = 0; j < seen[k].size(); ++j) {
        regions[k].stood.row(static_cast<Eigen::Index>(j)) = turns_[0].row(seen[k][j]);
      }
    }
  }

  const ScanLattice& lattice_;
  const GroundPlane& ground_;
  const TurnOptions& options_;
  Directed directed_;
  TurnView now_;
  const std::array<Points, 2>& turns_;
  std::array<PointsView, 2> views_;
  std::array<Directed, 2> others_;
  TurnView before_, after_;
  std::array<TurnExtent, 2> extents_;
};

void check_turn_options(const TurnOptions& options) {
  const auto refuse = [](const char* name, const char* expected, double value) {
    throw InputError(std::string(name) + ": expected a number " + expected + ", got " +
                     number_text(value));
  };
  if (!(options.nearest > 0.0)) refuse("nearest", "> 0", options.nearest);
  if (!(options.farthest > options.nearest)) refuse("farthest", "> nearest", options.farthest);
  if (!std::isfinite(options.height)) refuse("height", "that is finite", options.height);
  if (!(options.tolerance > 0.0 && std::isfinite(options.tolerance))) {
    refuse("tolerance", "> 0 that is finite", options.tolerance);
  }
  if (!(options.tolerance_share >= 0.0 && std::isfinite(options.tolerance_share))) {
    refuse("tolerance_share", ">= 0 that is finite", options.tolerance_share);
  }
}

// @param reading  Lattice reading of the points; null: it is computed.
TurnResult compared(const PointsView& points, const PointsView& previous,
                    const PointsView& following, const ScanLattice& lattice,
                    LatticeReading* reading, const TurnOptions& options, const Progress& progress) {
  check_turn_options(options);
  check_readable(lattice);
  check_points(points);
  check_points(previous);
  check_points(following);
  TurnResult result;
  const auto ground = find_ground_plane(points);
  result.has_ground = ground.has_value();
  if (!result.has_ground) return result;
  const SeenFromAbove seen(points, *ground);
  ScanAligner aligner(points, part_of(progress, 0.0, 0.1));
  result.previous =
      aligner.align(previous, seen.best_motion(previous, *ground), part_of(progress, 0.1, 0.4));
  result.following =
      aligner.align(following, seen.best_motion(following, *ground), part_of(progress, 0.4, 0.8));
  result.is_steady = goes_on(result.previous, result.following);
  if (!result.is_judged()) return result;
  const std::array<Points, 2> turns{moved_points(previous, result.previous),
                                    moved_points(following, result.following)};
  if (progress) progress(0.9);
  const Progress rest = part_of(progress, 0.9, 0.9);
  TurnComparison comparison(points, lattice,
                            reading != nullptr
                                ? std::move(*reading)
                                : read_lattice(points, lattice, options.num_threads, rest),
                            *ground, options, turns, rest);
  result.regions = comparison.run();
  result.seen = comparison.take_readings();
  return result;
}

}  // namespace

TurnResult compare_turns(const PointsView& points, const PointsView& previous,
                         const PointsView& following, const ScanLattice& lattice,
                         const TurnOptions& options, const Progress& progress) {
  return compared(points, previous, following, lattice, nullptr, options, progress);
}

TurnResult compare_turns(const PointsView& points, const PointsView& previous,
                         const PointsView& following, const ScanLattice& lattice,
                         LatticeReading reading, const TurnOptions& options,
                         const Progress& progress) {
  check_reading(reading, points, lattice);
  return compared(points, previous, following, lattice, &reading, options, progress);
}

}  // namespace manip3d
