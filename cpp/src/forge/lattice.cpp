#include "manip3d/forge/lattice.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

// Turned about the vertical to the nearest azimuth that is measured.
Vector3d to_azimuth_step(const Vector3d& p, const ScanLattice& lattice) {
  const double azimuth = arc_tangent(p.y(), p.x());
  const double steps = (azimuth - lattice.azimuth_phase) / lattice.azimuth_step;
  const double measured = lattice.azimuth_phase + std::nearbyint(steps) * lattice.azimuth_step;
  return rotation_about_z(measured - azimuth) * p;
}

// The nearest crossing of the ray through p with a ring's line: t z = slope t rho + offset.
Vector3d along_ray(const Vector3d& p, const ScanLattice& lattice, double max_move) {
  const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
  double best = 1.0 + max_move / std::max(p.norm(), 1e-9);
  bool found = false;
  for (const ScanLattice::Ring& ring : lattice.rings) {
    const double t = ring.offset / (p.z() - ring.slope * rho);
    if (std::isfinite(t) && t > 0.0 && std::abs(t - 1.0) < std::abs(best - 1.0)) {
      best = t;
      found = true;
    }
  }
  return found ? Vector3d(best * p) : p;
}

Vector3d snapped(Vector3d p, const ScanLattice& lattice, const SnapOptions& options) {
  if (options.azimuth && lattice.azimuth_step > 0.0) p = to_azimuth_step(p, lattice);
  if (options.along == Snapping::kRay) p = along_ray(p, lattice, options.max_move);
  // Where the ray meets no line nearby, and for the last bits of rounding: in height.
  const double rho = std::sqrt(p.x() * p.x() + p.y() * p.y());
  const ScanLattice::Ring& ring = lattice.rings[nearest_ring(lattice, rho, p.z())];
  p.z() = ring.slope * rho + ring.offset;
  return p;
}

}  // namespace

void check_lattice(const ScanLattice& lattice) {
  if (lattice.rings.empty()) throw InputError("lattice: expected rings, got none");
  for (const ScanLattice::Ring& ring : lattice.rings) {
    if (!(std::isfinite(ring.slope) && std::isfinite(ring.offset))) {
      throw InputError("lattice: expected finite slopes and offsets");
    }
  }
  // Finer than any rotor's encoder, and a turn would have columns without end; coarser, and it
  // would have none.
  const double step = lattice.azimuth_step;
  if (!(step == 0.0 || (step >= 1e-4 && step <= 1.0))) {
    throw InputError("lattice: expected an azimuth step of 0 or 1e-4 to 1 radian, got " +
                     std::to_string(step));
  }
  if (!(std::abs(lattice.azimuth_phase) <= 1e3)) {
    throw InputError("lattice: expected a phase in radians, got " +
                     std::to_string(lattice.azimuth_phase));
  }
}

std::int32_t nearest_ring(const ScanLattice& lattice, double rho, double z) {
  std::size_t best = 0;
  double distance = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < lattice.rings.size(); ++k) {
    const double d = std::abs(z - (lattice.rings[k].slope * rho + lattice.rings[k].offset));
    if (d < distance) {
      distance = d;
      best = k;
    }
  }
  return static_cast<std::int32_t>(best);
}

Forgery snap_to_lattice(const PointsView& scene, std::vector<std::int32_t> rows,
                        const ScanLattice& lattice, const SnapOptions& options, int num_threads) {
  check_points_everywhere(scene, num_threads);
  check_lattice(lattice);
  if (!(options.max_move >= 0.0)) throw InputError("max_move: expected >= 0");
  Edit edit;
  edit.moved = checked_rows(std::move(rows), scene.num_points());
  edit.moved_to.resize(static_cast<Eigen::Index>(edit.moved.size()), 3);
  for (std::size_t i = 0; i < edit.moved.size(); ++i) {
    const Vector3d p = scene.points.row(edit.moved[i]).transpose().cast<double>();
    edit.moved_to.row(static_cast<Eigen::Index>(i)) =
        snapped(p, lattice, options).cast<float>().transpose();
  }
  return apply_edit(scene, edit, num_threads);
}

}  // namespace manip3d
