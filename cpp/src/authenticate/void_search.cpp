#include "authenticate/void_search.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <span>

#include "authenticate/ring_image.hpp"
#include "geometry/constants.hpp"
#include "geometry/median.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

// A step counts as fired if it has at least kFiredShare of the votes of its busiest neighbour. In
// KITTI's frames fired steps have at least 0.74 of these; a step between two firings has none, or
// the votes of an object that was pasted there. If more than kSparseShare of all steps are fired,
// each step is taken as fired: steps with few votes then have another cause.
constexpr double kFiredShare = 0.6;
constexpr double kSparseShare = 0.8;  // of all steps; KITTI's frames have firings at 0.54
constexpr int kNeighbours = 2;
// Fewer votes than this decide nothing: at the border of a cropped frame few lasers see the rest.
constexpr int kMinVotes = 16;

// Metres: points this near to the plane are ground. The plane is approximate, since roads are
// crowned and climb.
double ground_band(double range) { return 0.35 + 0.015 * range; }

// A void consists of blocks of this many firings without a return, because single lost returns are
// everywhere. Lasers left and right of the axis see the edges of near objects one column apart, so
// that runs are widened by one.
constexpr int kBlockRings = 3;
constexpr int kBlockColumns = 5;
constexpr int kWidening = 1;

// A gap in a ring is judged only if the ring has returns on both sides of it, and if it is no
// longer than 42 degrees. Between two houses a distant street may return nothing up to the sky,
// without any edit. Therefore, unless the same column has returns again above, the returns beside
// the gap must be from the ground, or from about the ground's distance.
constexpr double kShareOfRange = 0.7;  // of the ground's range
constexpr int kSide = 8;               // firings
constexpr int kLongestColumnGap = 250;

// An earlier turn counts as having a return at a firing if at least kEarlierAnswers of the nearest
// five firings had one.
constexpr int kEarlierSpan = 2;
constexpr int kEarlierAnswers = 4;

// Largest shift of a hole between consecutive frames that is explained by motion: firings (8
// degrees) and lasers.
constexpr int kHoleColumns = 48;
constexpr int kHoleRings = 2;

// Horizontal distance, metres, at which a laser meets the ground plane in the direction of a
// column; 0: nowhere.
double ground_range(const ScanLattice& lattice, int ring, const GroundPlane& ground,
                    const SinCos& azimuth) {
  const double climb = ground.slope_x * azimuth.cos + ground.slope_y * azimuth.sin;
  const double approach = climb - lattice.rings[ring].slope;
  const double height = lattice.rings[ring].offset - ground.height;
  return approach > 0.0 && height > 0.0 ? height / approach : 0.0;
}

Answer answer_of(const Eigen::RowVector3d& p, int ring, const ScanLattice& lattice,
                 const GroundPlane& ground) {
  const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
  if (std::abs(ground.above(p.x(), p.y(), p.z())) < ground_band(rho)) return Answer::kGround;
  const double range = ground_range(lattice, ring, ground, {p.y() / rho, p.x() / rho});
  return range > 0.0 && rho > kShareOfRange * range ? Answer::kBeyond : Answer::kNearer;
}

// Columns of the firings of each laser; see Answers.
class Columns {
 public:
  Columns(const ScanLattice& lattice, const FiringSchedule& schedule)
      : schedule_(schedule), first_(lattice.num_rings()) {
    if (schedule.firings == 0) return;
    for (std::size_t ring = 0; ring < first_.size(); ++ring) {
      const double ahead = -lattice.rings[ring].azimuth;
      const double count = std::ceil(ahead / lattice.azimuth_step);
      const double steps = lattice.steps;
      auto k = static_cast<int>(count - std::floor(count / steps) * steps);
      while (schedule.order[k] < 0) k = (k + 1) % lattice.steps;
      first_[ring] = schedule.order[k];
    }
  }

  // Column of a count of the encoder; -1: no firing.
  [[nodiscard]] int operator()(int ring, int count) const {
    const int firing = schedule_.order[count];
    if (firing < 0) return -1;
    const int column = firing - first_[ring];
    return column < 0 ? column + schedule_.firings : column;
  }

 private:
  const FiringSchedule& schedule_;
  std::vector<int> first_;
};

enum class Support : std::uint8_t { kNone, kAnswers, kAsFar };

// Support of the firings in gaps of a ring: are there enough returns on both sides of the gap?
class Gaps {
 public:
  Gaps(const RingImage<Answer>& kind, int answered_beside)
      : kind_(kind),
        needed_(answered_beside),
        support_(kind.rings(), kind.columns(), Support::kNone) {
    for (int ring = 0; ring < kind.rings(); ++ring) find_in(ring);
  }

  [[nodiscard]] Support support(int ring, int column) const { return support_(ring, column); }

 private:
  [[nodiscard]] bool lost(int ring, int column) const {
    return kind_(ring, column % kind_.columns()) == Answer::kNone;
  }

  // Judges the gaps of a ring, starting from a return, so that no gap is split in two.
  void find_in(int ring) {
    const int columns = kind_.columns();
    int start = 0;
    while (start < columns && lost(ring, start)) ++start;
    if (start == columns) return;
    for (int column = start; column < start + columns;) {
      int end = column;
      while (end < start + columns && lost(ring, end)) ++end;
      if (end > column && end - column <= kLongestColumnGap) judge(ring, column, end);
      column = std::max(end, column + 1);
    }
  }

  void judge(int ring, int begin, int end) {
    std::array<int, 2> answers{};
    std::array<int, 2> as_far{};
    for (int k = 0; k < kSide; ++k) {
      for (const int side : {0, 1}) {
        const int column = side == 0 ? begin - 1 - k + kind_.columns() : end + k;
        const Answer answer = kind_(ring, column % kind_.columns());
        answers[side] += answer != Answer::kNone ? 1 : 0;
        as_far[side] += answer == Answer::kGround || answer == Answer::kBeyond ? 1 : 0;
      }
    }
    const auto enough = [this](const std::array<int, 2>& both) {
      return std::min(both[0], both[1]) >= needed_;
    };
    if (!enough(answers)) return;
    const Support support = enough(as_far) ? Support::kAsFar : Support::kAnswers;
    for (int k = begin; k < end; ++k) support_(ring, k % kind_.columns()) = support;
  }

  const RingImage<Answer>& kind_;
  int needed_;
  RingImage<Support> support_;
};

// Did a firing and its neighbours have returns in another turn? The scanner may have fired slightly
// more or less often in it.
bool was_answered(const Answers& other, int ring, int column, int columns) {
  const int there = other.kind.columns();
  if (there == 0) return false;
  const auto middle =
      static_cast<int>((static_cast<std::int64_t>(column) * there + there / 2) / columns);
  int answered = 0;
  for (int d = -kEarlierSpan; d <= kEarlierSpan; ++d) {
    const int near = other.kind.wrapped(other.kind.wrapped(middle) + d);
    answered += other.kind(ring, near) == Answer::kNone ? 0 : 1;
  }
  return answered >= kEarlierAnswers;
}

bool was_answered(const std::vector<const Answers*>& other_turns, int ring, int column,
                  int columns) {
  return std::all_of(other_turns.begin(), other_turns.end(), [&](const Answers* other) {
    return was_answered(*other, ring, column, columns);
  });
}

// Firings without a return that had one in both neighbouring turns.
RingImage<std::uint8_t> lost_between(const Answers& answers, const ScanLattice& lattice,
                                     const GroundPlane& ground, const VoidOptions& options) {
  const RingImage<Answer>& kind = answers.kind;
  RingImage<std::uint8_t> lost(kind.rings(), kind.columns(), 0);
  Ticker ticker(options.progress, 1U << 8);
  for (int column = 0; column < lost.columns(); ++column) {
    ticker.tick();
    const SinCos azimuth = sin_cos(kFullTurn * (column + 0.5) / lost.columns());
    for (int ring = 0; ring < lost.rings(); ++ring) {
      if (kind(ring, column) != Answer::kNone) continue;
      const double range = ground_range(lattice, ring, ground, azimuth);
      if (range > 0.0 && range < options.min_ground_range) continue;
      lost(ring, column) = was_answered(options.other_turns, ring, column, lost.columns());
    }
  }
  return lost;
}

// From the lowest laser upwards: runs of firings without a return that begin directly above ground.
RingImage<std::uint8_t> runs_above_ground(const Answers& answers, const ScanLattice& lattice,
                                          const GroundPlane& ground, const VoidOptions& options) {
  const RingImage<Answer>& kind = answers.kind;
  const Gaps gaps(kind, options.answered_beside);
  RingImage<std::uint8_t> runs(kind.rings(), kind.columns(), 0);
  Ticker ticker(options.progress, 1U << 8);
  for (int column = 0; column < runs.columns(); ++column) {
    ticker.tick();
    const SinCos azimuth = sin_cos(kFullTurn * (column + 0.5) / runs.columns());
    for (int ring = runs.rings() - 2; ring >= 0; --ring) {
      if (kind(ring, column) != Answer::kNone || kind(ring + 1, column) != Answer::kGround)
        continue;
      const int below = ring;
      while (ring >= 0 && kind(ring, column) == Answer::kNone) --ring;
      const bool closed = ring >= 0;
      for (int r = below; r > ring; --r) {
        const double range = ground_range(lattice, r, ground, azimuth);
        if (!(range > options.min_ground_range && range < options.max_ground_range)) continue;
        const Support support = gaps.support(r, column);
        if (support == Support::kNone || (support == Support::kAnswers && !closed)) continue;
        runs(r, column) = was_answered(options.other_turns, r, column, runs.columns());
      }
    }
  }
  return runs;
}

RingImage<std::uint8_t> widened(const RingImage<std::uint8_t>& image, Ticker& ticker) {
  RingImage<std::uint8_t> wide(image.rings(), image.columns(), 0);
  for (int ring = 0; ring < image.rings(); ++ring) {
    ticker.tick();
    for (int column = 0; column < image.columns(); ++column) {
      if (image(ring, column) == 0) continue;
      for (int d = -kWidening; d <= kWidening; ++d) wide(ring, image.wrapped(column + d)) = 1;
    }
  }
  return wide;
}

// Number of cells around a void without a return in another turn and with one in this turn. A dark
// car that passes leaves a hole of about its size in every turn; an edit of this turn leaves none
// in others.
int holes_beside(const std::vector<RingCell>& component, const Answers& answers,
                 const Answers& other) {
  const int rings = answers.kind.rings();
  const int columns = answers.kind.columns();
  int top = rings - 1;
  int bottom = 0;
  std::vector<std::uint8_t> around(columns, 0);
  for (const auto& [ring, column] : component) {
    top = std::min(top, ring);
    bottom = std::max(bottom, ring);
    around[column] = 1;
  }
  const std::vector<std::uint8_t> own = around;
  const int half = std::min(kHoleColumns, (columns - 1) / 2);
  for (int column = 0; column < columns; ++column) {
    if (own[column] == 0) continue;
    for (int d = -half; d <= half; ++d) around[answers.kind.wrapped(column + d)] = 1;
  }
  int holes = 0;
  for (int column = 0; column < columns; ++column) {
    if (around[column] == 0) continue;
    const auto there = static_cast<std::int64_t>(column) * other.kind.columns() / columns;
    for (int r = std::max(0, top - kHoleRings); r <= std::min(rings - 1, bottom + kHoleRings);
         ++r) {
      const bool closed = answers.kind(r, column) != Answer::kNone;
      holes += closed && other.kind(r, static_cast<int>(there)) == Answer::kNone ? 1 : 0;
    }
  }
  return holes;
}

// The share of a void that is not explained by a hole that moved here since another turn.
double unexplained(const std::vector<RingCell>& component, const Answers& answers,
                   const std::vector<const Answers*>& other_turns) {
  int holes = 0;
  for (const Answers* other : other_turns) {
    holes = std::max(holes, holes_beside(component, answers, *other));
  }
  const auto size = static_cast<double>(component.size());
  return std::max(0.0, 1.0 - holes / size);
}

// Horizontal distance of the next return below a lost cell; without one, of the next return above;
// without both, 0.
double contact_distance(const Answers& answers, const PointsView& points, int ring, int column) {
  const int last = answers.point.rings() - 1;
  int below = ring;
  while (below < last && answers.point(below, column) < 0) ++below;
  if (answers.point(below, column) >= 0) {
    ring = below;
  } else {
    while (ring > 0 && answers.point(ring, column) < 0) --ring;
  }
  if (answers.point(ring, column) < 0) return 0.0;
  const auto p = points.points.row(answers.point(ring, column)).cast<double>();
  return std::sqrt(p.x() * p.x() + p.y() * p.y());
}

}  // namespace

FiringSchedule find_firings(const LatticeReading& reading, const ScanLattice& lattice) {
  const int steps = lattice.steps;
  std::vector<int> votes(steps, 0);
  for (const std::int32_t count : reading.count) {
    if (count >= 0) ++votes[count];
  }
  FiringSchedule schedule{std::vector<std::int32_t>(steps, -1), std::vector<std::uint8_t>(steps, 0),
                          0};
  for (int k = 0; k < steps; ++k) {
    int busiest = 1;
    for (int d = -kNeighbours; d <= kNeighbours; ++d) {
      busiest = std::max(busiest, votes[(k + d + steps) % steps]);
    }
    schedule.judged[k] = busiest >= std::min(kMinVotes, lattice.num_rings() / 2) ? 1 : 0;
    if (votes[k] < kFiredShare * busiest) continue;
    schedule.order[k] = schedule.firings++;
  }
  if (schedule.firings > kSparseShare * steps) {
    std::iota(schedule.order.begin(), schedule.order.end(), 0);
    schedule.firings = steps;
  }
  return schedule;
}

Answers sort_answers(const PointsView& points, const LatticeReading& reading,
                     const ScanLattice& lattice, const FiringSchedule& schedule,
                     const GroundPlane& ground) {
  const Columns column_of(lattice, schedule);
  const int rings = lattice.num_rings();
  Answers answers{{rings, schedule.firings, Answer::kNone}, {rings, schedule.firings, -1}};
  for (Eigen::Index i = 0; i < points.num_points(); ++i) {
    if (reading.count(i) < 0) continue;
    const int column = column_of(reading.ring(i), reading.count(i));
    if (column < 0) continue;
    const Eigen::RowVector3d p = points.points.row(i).cast<double>();
    answers.kind(reading.ring(i), column) = answer_of(p, reading.ring(i), lattice, ground);
    answers.point(reading.ring(i), column) = static_cast<std::int32_t>(i);
  }
  return answers;
}

std::vector<Void> find_voids(const PointsView& points, const Answers& answers,
                             const ScanLattice& lattice, const GroundPlane& ground,
                             const VoidOptions& options) {
  const int columns = answers.kind.columns();
  if (columns < std::max(kBlockColumns, kSide)) return {};
  const auto runs = options.other_turns.size() > 1
                        ? lost_between(answers, lattice, ground, options)
                        : runs_above_ground(answers, lattice, ground, options);
  Ticker ticker(options.progress, 1U << 2);
  auto lost = opened(widened(runs, ticker), kBlockRings, kBlockColumns, ticker);
  std::vector<Void> voids;
  for (const auto& component : connected_components(lost)) {
    ticker.tick();
    Void found;
    std::vector<double> distances;
    for (const auto& [ring, column] : component) {
      if (runs(ring, column) == 0) continue;
      found.cells.push_back({ring, kFullTurn * (column + 0.5) / columns});
      distances.push_back(contact_distance(answers, points, ring, column));
    }
    found.distance = median(std::span(distances));
    if (options.other_turns.size() > 1)
      found.weight = unexplained(component, answers, options.other_turns);
    if (!(found.weight > 0.0)) continue;
    voids.push_back(std::move(found));
  }
  return voids;
}

}  // namespace manip3d
