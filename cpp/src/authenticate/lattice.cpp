#include "manip3d/authenticate/lattice.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "geometry/constants.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kChunk = 8192;
// Limits the tables with one byte per laser and step.
constexpr int kMaxRings = 1024;
constexpr int kMaxSteps = 65'536;
constexpr double kSmallestStep = 1e-6;  // metres
constexpr double kLargestStep = 1.0;
constexpr float kLargestAzimuth = 6.2831855F;  // radians: one turn, rounded to single precision
constexpr double kSmallestRho = 0.01;  // metres; nearer to the axis, lines cannot be distinguished

struct Beam : ScanLattice::Ring {
  double cos, sin;  // of the elevation
};

std::vector<Beam> beams_of(const ScanLattice& lattice) {
  std::vector<Beam> beams;
  for (const ScanLattice::Ring& ring : lattice.rings) {
    const double cos = 1.0 / std::sqrt(1.0 + ring.slope * ring.slope);
    beams.push_back({ring, cos, ring.slope * cos});
  }
  return beams;
}

// The line nearest to a point in height. Lines do not cross where points are, so that the distance
// has one minimum, which is searched from the ring of the previous point in the file.
int nearest_beam(const std::vector<Beam>& beams, double rho, double z, int guess) {
  const auto distance = [&](int k) { return std::abs(beams[k].height_above(rho, z)); };
  const int last = static_cast<int>(beams.size()) - 1;
  double best = distance(guess);
  while (guess < last && distance(guess + 1) < best) best = distance(++guess);
  while (guess > 0 && distance(guess - 1) <= best) best = distance(--guess);
  return guess;
}

// Signed distance to the nearest whole number, in [-0.5, 0.5).
double off_whole(double value) { return value - std::floor(value + 0.5); }

// Arc tangent without libm. For small arguments, as of all beams that pass close to the axis, the
// error is below 1e-12.
double small_arc_tangent(double t) {
  const double s = t * t;
  if (s < 1e-3) return t * (1.0 - s * (1.0 / 3.0 - s * (0.2 - s / 7.0)));
  return arc_tangent(t, 1.0);
}

class LatticeReader {
 public:
  LatticeReader(const PointsView& points, const ScanLattice& lattice, LatticeReading& reading)
      : points_(points),
        reading_(reading),
        beams_(beams_of(lattice)),
        steps_(lattice.steps),
        azimuth_step_(lattice.azimuth_step),
        range_step_(lattice.range_step) {}

  void read(std::int64_t begin, std::int64_t end) const {
    int ring = 0;
    for (std::int64_t i = begin; i < end; ++i) {
      const double x = points_.points(i, 0);
      const double y = points_.points(i, 1);
      const double z = points_.points(i, 2);
      const double rho = std::sqrt(x * x + y * y);
      if (rho < kSmallestRho) continue;
      ring = nearest_beam(beams_, rho, z, ring);
      read(i, x, y, z, rho, ring);
    }
  }

 private:
  void read(std::int64_t i, double x, double y, double z, double rho, int k) const {
    const Beam& ring = beams_[k];
    const double angle = arc_tangent(y, x);
    // Rounding y to -0.0 happens to the last point of a turn, and not to the first.
    const bool below = angle < 0.0 || (angle == 0.0 && std::signbit(y));
    reading_.azimuth(i) = static_cast<float>(below ? angle + kFullTurn : angle);
    if (!(rho > 2.0 * std::abs(ring.lateral))) return;  // inside the circle that the beams touch
    reading_.ring(i) = k;
    reading_.line_error(i) = static_cast<float>(ring.height_above(rho, z) * ring.cos);
    const double reach = std::sqrt(rho * rho - ring.lateral * ring.lateral);
    if (steps_ > 0) read_count(i, angle, rho, reach, ring);
    if (range_step_ > 0.0) {
      const double range = reach * ring.cos + z * ring.sin;
      const double off = off_whole((range - ring.range_phase) / range_step_) * range_step_;
      reading_.range_error(i) = static_cast<float>(off);
    }
  }

  void read_count(std::int64_t i, double angle, double rho, double reach, const Beam& ring) const {
    // The beam passes the axis at the distance `lateral`: the point's azimuth differs from the
    // beam's by asin(lateral / rho).
    const double beam = angle - small_arc_tangent(ring.lateral / reach);
    const double count = (beam - ring.azimuth) / azimuth_step_;
    const double whole = std::floor(count + 0.5);
    reading_.step_error(i) = static_cast<float>((count - whole) * azimuth_step_ * rho);
    const auto steps = static_cast<double>(steps_);
    reading_.count(i) = static_cast<std::int32_t>(whole - std::floor(whole / steps) * steps);
  }

  const PointsView& points_;
  LatticeReading& reading_;
  std::vector<Beam> beams_;
  int steps_;
  double azimuth_step_;
  double range_step_;
};

void check_step(double step, const char* name) {
  if (step == 0.0 || (step >= kSmallestStep && step <= kLargestStep)) return;
  throw InputError(std::string("lattice: expected a ") + name + " of 1e-6 to 1 m or 0, got " +
                   number_text(step));
}

}  // namespace

void check_readable(const ScanLattice& lattice) {
  check_lattice(lattice);
  if (lattice.num_rings() > kMaxRings) {
    throw InputError("lattice: expected 1 to " + std::to_string(kMaxRings) + " rings, got " +
                     std::to_string(lattice.num_rings()));
  }
  for (int k = 0; k < lattice.num_rings(); ++k) {
    const ScanLattice::Ring& ring = lattice.rings[k];
    if (k > 0 && !(ring.slope < lattice.rings[k - 1].slope)) {
      throw InputError("lattice: expected descending slopes, got " + number_text(ring.slope) +
                       " in ring " + std::to_string(k));
    }
    if (!(std::abs(ring.azimuth) <= kFullTurn)) {
      throw InputError("lattice: expected azimuths within one turn of 0");
    }
  }
  if (lattice.steps < 0 || lattice.steps > kMaxSteps) {
    throw InputError("lattice: expected 0 to " + std::to_string(kMaxSteps) + " steps, got " +
                     std::to_string(lattice.steps));
  }
  constexpr double kRounding = 1e-6;  // radians
  if (lattice.steps > 0 &&
      !(std::abs(lattice.azimuth_step * lattice.steps - kFullTurn) <= kRounding)) {
    throw InputError("lattice: expected an azimuth_step of a turn divided by " +
                     std::to_string(lattice.steps) + " steps, got " +
                     number_text(lattice.azimuth_step));
  }
  check_step(lattice.range_step, "range_step");
  check_step(lattice.coordinate_step, "coordinate_step");
}

LatticeReading read_lattice(const PointsView& points, const ScanLattice& lattice, int num_threads,
                            const Progress& progress) {
  check_points(points);
  check_readable(lattice);
  const Eigen::Index n = points.num_points();
  LatticeReading reading{Indices::Constant(n, -1), Indices::Constant(n, -1),
                         Eigen::VectorXf::Zero(n), Eigen::VectorXf::Zero(n),
                         Eigen::VectorXf::Zero(n), Eigen::VectorXf::Zero(n)};
  const LatticeReader reader(points, lattice, reading);
  const auto read = [&](std::int64_t begin, std::int64_t end) { reader.read(begin, end); };
  parallel_chunks(n, kChunk, num_threads, read, progress);
  return reading;
}

void check_reading(const LatticeReading& reading, const PointsView& points,
                   const ScanLattice& lattice) {
  check_points(points);
  check_readable(lattice);
  const Eigen::Index n = points.num_points();
  for (const Eigen::Index size :
       {reading.ring.size(), reading.count.size(), reading.azimuth.size(),
        reading.line_error.size(), reading.step_error.size(), reading.range_error.size()}) {
    if (size == n) continue;
    throw InputError("reading: expected that of " + std::to_string(n) + " points, got that of " +
                     std::to_string(size));
  }
  const auto refuse = [](const char* what, Eigen::Index i) {
    throw InputError(std::string("reading: expected ") + what + " of the lattice in row " +
                     std::to_string(i));
  };
  for (Eigen::Index i = 0; i < n; ++i) {
    if (reading.ring(i) < -1 || reading.ring(i) >= lattice.num_rings()) refuse("a ring", i);
    if (reading.count(i) < -1 || (lattice.steps > 0 && reading.count(i) >= lattice.steps)) {
      refuse("a count", i);
    }
    if (!(reading.azimuth(i) >= 0.0F && reading.azimuth(i) <= kLargestAzimuth)) {
      refuse("an azimuth", i);
    }
  }
}

}  // namespace manip3d
