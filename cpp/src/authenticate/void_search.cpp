#include "authenticate/void_search.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "authenticate/ring_image.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

constexpr double kFullTurn = 2.0 * std::numbers::pi;

// A fired step has at least 0.74 of the votes of its busiest neighbour in KITTI's frames; a step
// between two firings has none, or those of an object pasted there.
constexpr double kFiredShare = 0.6;
constexpr int kNeighbours = 2;

// Ground is taken for ground where it is this near to the plane: roads are crowned and climb.
double ground_band(double range) { return 0.2 + 0.01 * range; }

// A void is built of blocks of so many firings; single lost returns are everywhere.
constexpr int kBlockRings = 3;
constexpr int kBlockColumns = 4;

// Column of each firing for one laser: they are counted from straight ahead, so that columns of
// different lasers lie above each other although each laser looks another way when it fires.
class Columns {
 public:
  Columns(const RingLattice& lattice, const FiringSchedule& schedule)
      : schedule_(schedule), first_(static_cast<std::size_t>(lattice.num_rings())) {
    for (std::size_t ring = 0; ring < first_.size(); ++ring) {
      const double ahead = -lattice.azimuth(static_cast<Eigen::Index>(ring));
      const double count = std::ceil(ahead / lattice.azimuth_step());
      const double steps = lattice.steps;
      auto k = static_cast<int>(count - std::floor(count / steps) * steps);
      while (schedule.order[static_cast<std::size_t>(k)] < 0) k = (k + 1) % lattice.steps;
      first_[ring] = schedule.order[static_cast<std::size_t>(k)];
    }
  }

  // -1: not a firing.
  [[nodiscard]] int operator()(int ring, int count) const {
    const int firing = schedule_.order[static_cast<std::size_t>(count)];
    if (firing < 0) return -1;
    const int column = firing - first_[static_cast<std::size_t>(ring)];
    return column < 0 ? column + schedule_.firings : column;
  }

 private:
  const FiringSchedule& schedule_;
  std::vector<int> first_;
};

enum class Answer : std::uint8_t { kNone, kGround, kOther };

struct Answers {
  RingImage<Answer> kind;
  RingImage<std::int32_t> point;
};

Answers sort_answers(const PointsView& points, const LatticeReading& reading,
                     const Columns& column_of, const GroundPlane& ground, int rings, int columns) {
  Answers answers{{rings, columns, Answer::kNone}, {rings, columns, -1}};
  for (Eigen::Index i = 0; i < points.num_points(); ++i) {
    if (reading.count(i) < 0) continue;
    const int column = column_of(reading.ring(i), reading.count(i));
    if (column < 0) continue;
    const Eigen::RowVector3d p = points.points.row(i).cast<double>();
    const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
    const bool low = std::abs(ground.above(p.x(), p.y(), p.z())) < ground_band(rho);
    answers.kind(reading.ring(i), column) = low ? Answer::kGround : Answer::kOther;
    answers.point(reading.ring(i), column) = static_cast<std::int32_t>(i);
  }
  return answers;
}

// Horizontal distance at which a laser that looks along a column meets the plane; 0: nowhere.
double ground_range(const RingLattice& lattice, int ring, const GroundPlane& ground,
                    const SinCos& azimuth) {
  const double climb = ground.slope_x * azimuth.cos + ground.slope_y * azimuth.sin;
  const double approach = climb - lattice.slope(ring);
  const double height = lattice.offset(ring) - ground.height;
  return approach > 0.0 && height > 0.0 ? height / approach : 0.0;
}

// From the lowest laser upwards: runs without a return that begin directly above ground.
RingImage<std::uint8_t> runs_above_ground(const Answers& answers, const RingLattice& lattice,
                                          const GroundPlane& ground, const VoidOptions& options) {
  RingImage<std::uint8_t> runs(answers.kind.rings(), answers.kind.columns(), 0);
  for (int column = 0; column < runs.columns(); ++column) {
    const SinCos azimuth = sin_cos(kFullTurn * (column + 0.5) / runs.columns());
    bool inside = false;
    for (int ring = runs.rings() - 2; ring >= 0; --ring) {
      const bool lost = answers.kind(ring, column) == Answer::kNone;
      inside = lost && (inside || answers.kind(ring + 1, column) == Answer::kGround);
      if (!inside) continue;
      const double range = ground_range(lattice, ring, ground, azimuth);
      inside = range > options.min_ground_range && range < options.max_ground_range;
      runs(ring, column) = inside ? 1 : 0;
    }
  }
  return runs;
}

// Morphological opening by a block: what no full block covers is erased.
RingImage<std::uint8_t> opened(const RingImage<std::uint8_t>& image) {
  RingImage<std::uint8_t> kept(image.rings(), image.columns(), 0);
  for (int ring = 0; ring + kBlockRings <= image.rings(); ++ring) {
    for (int column = 0; column < image.columns(); ++column) {
      bool full = true;
      for (int r = 0; full && r < kBlockRings; ++r) {
        for (int c = 0; full && c < kBlockColumns; ++c) {
          full = image(ring + r, image.wrapped(column + c)) != 0;
        }
      }
      if (!full) continue;
      for (int r = 0; r < kBlockRings; ++r) {
        for (int c = 0; c < kBlockColumns; ++c) kept(ring + r, image.wrapped(column + c)) = 1;
      }
    }
  }
  return kept;
}

// Horizontal distance of the return below a cell of a run: there is one, or no run had begun.
double contact_distance(const Answers& answers, const PointsView& points, int ring, int column) {
  while (answers.point(ring, column) < 0) ++ring;
  const auto p = points.points.row(answers.point(ring, column)).cast<double>();
  return std::sqrt(p.x() * p.x() + p.y() * p.y());
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

FiringSchedule find_firings(const LatticeReading& reading, const RingLattice& lattice) {
  const int steps = lattice.steps;
  std::vector<int> votes(static_cast<std::size_t>(steps), 0);
  for (const std::int32_t count : reading.count) {
    if (count >= 0) ++votes[static_cast<std::size_t>(count)];
  }
  FiringSchedule schedule{std::vector<std::int32_t>(static_cast<std::size_t>(steps), -1), 0};
  for (int k = 0; k < steps; ++k) {
    int busiest = 1;
    for (int d = -kNeighbours; d <= kNeighbours; ++d) {
      busiest = std::max(busiest, votes[static_cast<std::size_t>((k + d + steps) % steps)]);
    }
    if (votes[static_cast<std::size_t>(k)] < kFiredShare * busiest) continue;
    schedule.order[static_cast<std::size_t>(k)] = schedule.firings++;
  }
  return schedule;
}

std::vector<Void> find_voids(const PointsView& points, const LatticeReading& reading,
                             const RingLattice& lattice, const FiringSchedule& schedule,
                             const GroundPlane& ground, const VoidOptions& options) {
  if (schedule.firings < kBlockColumns) return {};
  const Columns column_of(lattice, schedule);
  const Answers answers =
      sort_answers(points, reading, column_of, ground, lattice.num_rings(), schedule.firings);
  const auto lost = opened(runs_above_ground(answers, lattice, ground, options));
  std::vector<Void> voids;
  for (const auto& component : connected_components(lost)) {
    Void found;
    std::vector<double> distances;
    for (const auto& [ring, column] : component) {
      found.cells.push_back({ring, kFullTurn * (column + 0.5) / schedule.firings});
      distances.push_back(contact_distance(answers, points, ring, column));
    }
    found.distance = median(std::move(distances));
    voids.push_back(std::move(found));
  }
  return voids;
}

}  // namespace manip3d
