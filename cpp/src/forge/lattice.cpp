#include "manip3d/forge/lattice.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "forge/cylindrical.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

// The point, rotated about the vertical to the nearest azimuth step.
Vector3d to_azimuth_step(const Vector3d& p, const ScanLattice& lattice) {
  const double phase = lattice.rings.front().azimuth;
  const double azimuth = arc_tangent(p.y(), p.x());
  const double steps = (azimuth - phase) / lattice.azimuth_step;
  const double measured = phase + std::nearbyint(steps) * lattice.azimuth_step;
  return rotation_about_z(measured - azimuth) * p;
}

// The nearest crossing of the ray through p with a ring's line: t z = slope t rho + offset. p
// itself if there is none within `max_move`.
Vector3d along_ray(const Vector3d& p, const ScanLattice& lattice, double max_move) {
  const double rho = rho_of(p);
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
  // The height is set in any case: the ray may have met no line nearby, and it leaves rounding
  // errors.
  const double rho = rho_of(p);
  const ScanLattice::Ring& ring = lattice.rings[nearest_ring(lattice, rho, p.z())];
  p.z() = ring.slope * rho + ring.offset;
  return p;
}

}  // namespace

void check_azimuths(const ScanLattice& lattice) {
  check_lattice(lattice);
  const double step = lattice.azimuth_step;
  if (!(step == 0.0 || (step >= 1e-4 && step <= 1.0))) {
    throw InputError("lattice: expected an azimuth step of 0 or 1e-4 to 1 radian, got " +
                     number_text(step));
  }
  for (const ScanLattice::Ring& ring : lattice.rings) {
    if (std::abs(ring.azimuth) <= 1e3 && ring.azimuth == lattice.rings.front().azimuth) continue;
    throw InputError("lattice: expected one phase of all rings in radians, got " +
                     number_text(ring.azimuth));
  }
}

Forgery snap_to_lattice(const PointsView& scene, std::vector<std::int32_t> rows,
                        const ScanLattice& lattice, const SnapOptions& options, int num_threads,
                        const Progress& progress) {
  check_points_everywhere(scene, num_threads, progress);
  check_azimuths(lattice);
  if (!(options.max_move >= 0.0)) throw InputError("max_move: expected >= 0");
  Edit edit;
  edit.moved = checked_rows(std::move(rows), scene.num_points());
  // A pulse without a return has no direction to snap, and would become a point at the scanner.
  std::erase_if(edit.moved, [&](std::int32_t row) {
    const auto p = scene.points.row(row);
    return is_no_return(p.x(), p.y(), p.z());
  });
  edit.moved_to.resize(static_cast<Eigen::Index>(edit.moved.size()), 3);
  Ticker ticker(progress);
  for (std::size_t i = 0; i < edit.moved.size(); ++i) {
    ticker.tick();
    const Vector3d p = scene.points.row(edit.moved[i]).transpose().cast<double>();
    edit.moved_to.row(static_cast<Eigen::Index>(i)) =
        snapped(p, lattice, options).cast<float>().transpose();
  }
  return apply_edit(scene, std::move(edit), num_threads, progress);
}

}  // namespace manip3d
