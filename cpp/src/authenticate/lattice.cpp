#include "manip3d/authenticate/lattice.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

constexpr double kFullTurn = 2.0 * std::numbers::pi;
constexpr std::int64_t kChunk = 8192;
// A byte for each laser and step is held.
constexpr Eigen::Index kMaxRings = 1024;
constexpr int kMaxSteps = 65'536;
constexpr double kSmallestStep = 1e-6;  // metres
constexpr double kLargestStep = 1.0;
constexpr double kSmallestRho = 0.01;  // metres; nearer to the axis no line is told from another

// What one laser needs to read a point.
struct Ring {
  double slope, offset, lateral, azimuth, range_phase;
  double cos, sin;  // of its elevation
};

std::vector<Ring> rings_of(const RingLattice& lattice) {
  std::vector<Ring> rings;
  for (int k = 0; k < lattice.num_rings(); ++k) {
    const double slope = lattice.slope(k);
    const double cos = 1.0 / std::sqrt(1.0 + slope * slope);
    rings.push_back({slope, lattice.offset(k), lattice.lateral(k), lattice.azimuth(k),
                     lattice.range_phase(k), cos, slope * cos});
  }
  return rings;
}

double height_above(const Ring& ring, double rho, double z) {
  return z - ring.slope * rho - ring.offset;
}

// Lines do not cross where points are, so the distance falls towards the nearest one and rises
// behind it; a point's predecessor in the file is mostly of the same ring.
int nearest_ring(const std::vector<Ring>& rings, double rho, double z, int guess) {
  const auto distance = [&](int k) {
    return std::abs(height_above(rings[static_cast<std::size_t>(k)], rho, z));
  };
  const int last = static_cast<int>(rings.size()) - 1;
  double best = distance(guess);
  while (guess < last && distance(guess + 1) < best) best = distance(++guess);
  while (guess > 0 && distance(guess - 1) <= best) best = distance(--guess);
  return guess;
}

// Distance to the nearest whole number, in (-0.5, 0.5].
double off_whole(double value) { return value - std::floor(value + 0.5); }

// The same to 1e-12 where beams pass the axis closely, as they do.
double small_arc_tangent(double t) {
  const double s = t * t;
  if (s < 1e-3) return t * (1.0 - s * (1.0 / 3.0 - s * (0.2 - s / 7.0)));
  return arc_tangent(t, 1.0);
}

class Reader {
 public:
  Reader(const PointsView& points, const RingLattice& lattice, LatticeReading& reading)
      : points_(points),
        reading_(reading),
        rings_(rings_of(lattice)),
        steps_(lattice.steps),
        azimuth_step_(lattice.azimuth_step()),
        range_step_(lattice.range_step) {}

  void read(std::int64_t begin, std::int64_t end) const {
    int ring = 0;
    for (std::int64_t i = begin; i < end; ++i) {
      const double x = points_.points(i, 0);
      const double y = points_.points(i, 1);
      const double z = points_.points(i, 2);
      const double rho = std::sqrt(x * x + y * y);
      if (rho < kSmallestRho) continue;
      ring = nearest_ring(rings_, rho, z, ring);
      read(i, x, y, z, rho, ring);
    }
  }

 private:
  void read(std::int64_t i, double x, double y, double z, double rho, int k) const {
    const Ring& ring = rings_[static_cast<std::size_t>(k)];
    const double angle = arc_tangent(y, x);
    reading_.azimuth(i) = static_cast<float>(angle < 0.0 ? angle + kFullTurn : angle);
    if (!(rho > 2.0 * std::abs(ring.lateral))) return;  // inside the circle of the beams
    reading_.ring(i) = k;
    reading_.line_error(i) = static_cast<float>(height_above(ring, rho, z) * ring.cos);
    const double reach = std::sqrt(rho * rho - ring.lateral * ring.lateral);
    if (steps_ > 0) read_count(i, angle, rho, reach, ring);
    if (range_step_ > 0.0) {
      const double range = reach * ring.cos + z * ring.sin;
      const double off = off_whole((range - ring.range_phase) / range_step_) * range_step_;
      reading_.range_error(i) = static_cast<float>(off);
    }
  }

  void read_count(std::int64_t i, double angle, double rho, double reach, const Ring& ring) const {
    // The beam passes the axis at `lateral`: the point lies asin(lateral / rho) beside it.
    const double beam = angle - small_arc_tangent(ring.lateral / reach);
    const double count = (beam - ring.azimuth) / azimuth_step_;
    const double whole = std::floor(count + 0.5);
    reading_.step_error(i) = static_cast<float>((count - whole) * azimuth_step_ * rho);
    const auto steps = static_cast<double>(steps_);
    reading_.count(i) = static_cast<std::int32_t>(whole - std::floor(whole / steps) * steps);
  }

  const PointsView& points_;
  LatticeReading& reading_;
  std::vector<Ring> rings_;
  int steps_;
  double azimuth_step_;
  double range_step_;
};

void check_column(const Eigen::VectorXd& column, Eigen::Index rows, const char* name) {
  if (column.size() != rows) {
    throw InputError("lattice: expected " + std::to_string(rows) + " values of " + name + ", got " +
                     std::to_string(column.size()));
  }
  if (!column.allFinite()) {
    throw InputError(std::string("lattice: expected finite numbers in ") + name);
  }
}

void check_step(double step, const char* name) {
  if (step == 0.0 || (step >= kSmallestStep && step <= kLargestStep)) return;
  throw InputError(std::string("lattice: expected a ") + name + " of 1e-6 to 1 m or 0, got " +
                   std::to_string(step));
}

}  // namespace

double RingLattice::uncertainty(int ring, double rho) const {
  return 4.0 * slope_error(ring) * std::abs(rho - center(ring));
}

double RingLattice::azimuth_step() const { return steps > 0 ? kFullTurn / steps : 0.0; }

void check_lattice(const RingLattice& lattice) {
  const Eigen::Index rows = lattice.slope.size();
  if (rows < 1 || rows > kMaxRings) {
    throw InputError("lattice: expected 1 to " + std::to_string(kMaxRings) + " rings, got " +
                     std::to_string(rows));
  }
  check_column(lattice.slope, rows, "slope");
  check_column(lattice.offset, rows, "offset");
  check_column(lattice.lateral, rows, "lateral");
  check_column(lattice.azimuth, rows, "azimuth");
  check_column(lattice.range_phase, rows, "range_phase");
  check_column(lattice.center, rows, "center");
  check_column(lattice.slope_error, rows, "slope_error");
  for (Eigen::Index k = 1; k < rows; ++k) {
    if (lattice.slope(k) < lattice.slope(k - 1)) continue;
    throw InputError("lattice: expected descending slopes, got " +
                     std::to_string(lattice.slope(k)) + " in ring " + std::to_string(k));
  }
  if (!(lattice.azimuth.cwiseAbs().maxCoeff() <= kFullTurn)) {
    throw InputError("lattice: expected azimuths within one turn of 0");
  }
  if (lattice.steps < 0 || lattice.steps > kMaxSteps) {
    throw InputError("lattice: expected 0 to " + std::to_string(kMaxSteps) + " steps, got " +
                     std::to_string(lattice.steps));
  }
  check_step(lattice.range_step, "range_step");
  check_step(lattice.coordinate_step, "coordinate_step");
}

LatticeReading read_lattice(const PointsView& points, const RingLattice& lattice, int num_threads) {
  check_points(points);
  check_lattice(lattice);
  const Eigen::Index n = points.num_points();
  LatticeReading reading{Indices::Constant(n, -1), Indices::Constant(n, -1),
                         Eigen::VectorXf::Zero(n), Eigen::VectorXf::Zero(n),
                         Eigen::VectorXf::Zero(n), Eigen::VectorXf::Zero(n)};
  const Reader reader(points, lattice, reading);
  parallel_chunks(n, kChunk, num_threads,
                  [&](std::int64_t begin, std::int64_t end) { reader.read(begin, end); });
  return reading;
}

}  // namespace manip3d
