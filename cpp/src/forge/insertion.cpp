#include "manip3d/forge/insertion.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "forge/cylindrical.hpp"
#include "geometry/constants.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/nearest_neighbours.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// cos 80 degrees: largest half angle of the cone, since its tangent plane ends at 90 degrees
constexpr double kWidest = 0.17;

double azimuth_of(const Vector3d& p) { return arc_tangent(p.y(), p.x()); }

struct Ray {
  Vector3d start, direction;  // the scene's point is start + direction
  double squared_length;      // squared length of `direction`
  double hit = kInfinity;     // distance of the hit, in lengths of `direction`

  Ray(const Vector3d& from, const Vector3d& along)
      : start(from), direction(along), squared_length(along.squaredNorm()) {}
};

// The cone with its apex at the scanner that contains the object, and with it all that it hides.
struct Cone {
  Vector3d origin, axis;
  double cos_half = 1.0;

  Cone(const Vector3d& from, const Points& object) : origin(from), axis(Vector3d::Zero()) {
    const auto direction = [&](Eigen::Index i) -> Vector3d {
      return (object.row(i).transpose().cast<double>() - origin).normalized();
    };
    for (Eigen::Index i = 0; i < object.rows(); ++i) axis += direction(i);
    axis.normalize();
    for (Eigen::Index i = 0; i < object.rows(); ++i) {
      cos_half = std::min(cos_half, axis.dot(direction(i)));
    }
    if (!(cos_half > kWidest)) {
      throw InputError("position: expected the object to one side of the scanner");
    }
  }

  [[nodiscard]] bool holds(const Vector3d& p) const {
    const Vector3d v = p - origin;
    const double along = v.dot(axis);
    return along > 0.0 && along * along >= cos_half * cos_half * v.squaredNorm() * (1.0 - 1e-9);
  }
};

// Rays in square cells of the plane across the cone's axis, in which straight edges stay straight.
class RayGrid {
 public:
  RayGrid(const Cone& cone, const std::vector<Ray>& rays) : origin_(cone.origin) {
    e_ = cone.axis.unitOrthogonal();
    f_ = cone.axis.cross(e_);
    axis_ = cone.axis;
    const double half = std::sqrt(1.0 - cone.cos_half * cone.cos_half) / cone.cos_half;
    cells_ = std::clamp<std::int64_t>(
        static_cast<std::int64_t>(std::sqrt(static_cast<double>(rays.size()) / 2.0)), 1, 2048);
    low_ = -half - 1e-9;
    cell_ = 2.0 * (half + 1e-9) / static_cast<double>(cells_);
    start_.resize(cells_ * cells_ + 1);
    std::vector<std::int64_t> cell_of(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) {
      cell_of[i] = cell(project(rays[i].start + rays[i].direction));
      ++start_[cell_of[i] + 1];
    }
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    place_.resize(rays.size());
    std::vector<std::int64_t> next(start_.begin(), start_.end() - 1);
    for (std::size_t i = 0; i < rays.size(); ++i) place_[i] = next[cell_of[i]]++;
    rays_.assign(rays.size(), Ray(origin_, axis_));
    for (std::size_t i = 0; i < rays.size(); ++i) rays_[place_[i]] = rays[i];
  }

  /// The i-th ray, in the order of the constructor's argument.
  [[nodiscard]] const Ray& ray(std::size_t i) const { return rays_[place_[i]]; }

  [[nodiscard]] Vector2d project(const Vector3d& p) const {
    const Vector3d v = p - origin_;
    const double along = std::max(v.dot(axis_), 1e-12);
    return {v.dot(e_) / along, v.dot(f_) / along};
  }

  /// Calls visit(ray) for the rays in cells that touch a rectangle of the plane.
  template <typename Visit>
  void visit(const Vector2d& low, const Vector2d& high, const Visit& visit_ray) {
    const std::int64_t first = index(low.y());
    const std::int64_t last = index(high.y());
    for (std::int64_t i = index(low.x()); i <= index(high.x()); ++i) {
      const std::int64_t end = start_[i * cells_ + last + 1];
      for (std::int64_t k = start_[i * cells_ + first]; k < end; ++k) visit_ray(rays_[k]);
    }
  }

 private:
  [[nodiscard]] std::int64_t index(double u) const {
    return static_cast<std::int64_t>(
        std::clamp((u - low_) / cell_, 0.0, static_cast<double>(cells_ - 1)));
  }
  [[nodiscard]] std::int64_t cell(const Vector2d& p) const {
    return index(p.x()) * cells_ + index(p.y());
  }

  Vector3d origin_, axis_, e_, f_;
  std::int64_t cells_ = 1;
  double low_ = 0.0, cell_ = 1.0;
  std::vector<std::int64_t> start_;  // index of the first ray of each cell
  std::vector<Ray> rays_;
  std::vector<std::int64_t> place_;  // place in `rays_` of each ray of the constructor's argument
};

// Moller & Trumbore, Journal of Graphics Tools 2(1), 1997. Both sides of the triangle are hit.
double hit_triangle(const Ray& ray, const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  const Vector3d ab = b - a;
  const Vector3d ac = c - a;
  const Vector3d p = ray.direction.cross(ac);
  const double determinant = ab.dot(p);
  if (determinant == 0.0) return kInfinity;
  const Vector3d s = ray.start - a;
  const double u = s.dot(p) / determinant;
  if (!(u >= 0.0 && u <= 1.0)) return kInfinity;
  const Vector3d q = s.cross(ab);
  const double v = ray.direction.dot(q) / determinant;
  if (!(v >= 0.0 && u + v <= 1.0)) return kInfinity;
  const double t = ac.dot(q) / determinant;
  return t > 0.0 ? t : kInfinity;
}

// A disc perpendicular to the ray stands for a point of a cloud.
double hit_disc(const Ray& ray, const Vector3d& center, double radius) {
  const double t = (center - ray.start).dot(ray.direction) / ray.squared_length;
  const double miss = (ray.start + t * ray.direction - center).squaredNorm();
  return t > 0.0 && miss <= radius * radius ? t : kInfinity;
}

// Lasers are not exactly in the origin, so that a ray that meets the object may be in a
// neighbouring cell: the largest such displacement in the plane of RayGrid.
double parallax(const ScanLattice& lattice, const Points& object, const Vector3d& origin) {
  double offset = 0.0;
  for (const ScanLattice::Ring& ring : lattice.rings) {
    offset = std::max(offset, std::abs(ring.offset));
  }
  double nearest = kInfinity;
  for (Eigen::Index i = 0; i < object.rows(); ++i) {
    nearest = std::min(nearest, (object.row(i).transpose().cast<double>() - origin).norm());
  }
  return offset / std::max(nearest, 1e-6);
}

void hit_faces(const Points& object, const Eigen::Ref<const Faces>& faces, double margin,
               const Progress& progress, RayGrid& grid) {
  Ticker ticker(progress, 1U << 6);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    ticker.tick();
    const Vector3d a = object.row(faces(f, 0)).transpose().cast<double>();
    const Vector3d b = object.row(faces(f, 1)).transpose().cast<double>();
    const Vector3d c = object.row(faces(f, 2)).transpose().cast<double>();
    const Vector2d ua = grid.project(a);
    const Vector2d ub = grid.project(b);
    const Vector2d uc = grid.project(c);
    const Vector2d low = ua.cwiseMin(ub).cwiseMin(uc).array() - margin;
    const Vector2d high = ua.cwiseMax(ub).cwiseMax(uc).array() + margin;
    grid.visit(low, high,
               [&](Ray& ray) { ray.hit = std::min(ray.hit, hit_triangle(ray, a, b, c)); });
  }
}

void hit_discs(const Points& object, double margin, const Cone& cone, int num_threads,
               const Progress& progress, RayGrid& grid) {
  if (object.rows() < 2) return;
  const Vector3d middle = object.cast<double>().colwise().mean().transpose();
  const LargeArray<double> spacing =
      nearest_distances(PointsView({object.data(), object.rows(), 3}),
                        // `middle` is inside the object, so that neighbours are searched in all
                        // directions
                        {.origin = middle, .num_threads = num_threads}, progress);
  Ticker ticker(progress, 1U << 6);
  for (Eigen::Index i = 0; i < object.rows(); ++i) {
    ticker.tick();
    const Vector3d p = object.row(i).transpose().cast<double>();
    const double radius = spacing[i];
    const double reach = margin + radius / std::max((p - cone.origin).dot(cone.axis), 1e-6);
    const Vector2d u = grid.project(p);
    grid.visit(u.array() - reach, u.array() + reach,
               [&](Ray& ray) { ray.hit = std::min(ray.hit, hit_disc(ray, p, radius)); });
  }
}

// Points within the cone. Most are rejected in single precision with some slack.
std::vector<std::int32_t> rows_in_cone(const PointsView& scene, const Cone& cone, int num_threads,
                                       const Progress& progress) {
  const Eigen::Vector3f origin = cone.origin.cast<float>();
  const Eigen::Vector3f axis = cone.axis.cast<float>();
  const double slack = 1e-4 * (1.0 + cone.origin.norm());
  const auto bound = static_cast<float>(cone.cos_half * cone.cos_half * (1.0 - slack));
  const auto tiny = static_cast<float>(slack);
  const auto seen = [&](float x, float y, float z) {
    const Eigen::Vector3f v(x - origin.x(), y - origin.y(), z - origin.z());
    const float along = v.x() * axis.x() + v.y() * axis.y() + v.z() * axis.z() + tiny;
    if (along < 0.0F || along * along < bound * v.squaredNorm()) return false;
    return cone.holds(Vector3d(x, y, z));
  };
  return select_rows(scene, num_threads, seen, progress);
}

// The ring of each point of `seen`; empty without a lattice.
std::vector<std::int32_t> rings_of(const PointsView& scene, const std::vector<std::int32_t>& seen,
                                   const InsertionOptions& options, int num_threads,
                                   const Progress& progress) {
  std::vector<std::int32_t> rings(options.lattice.rings.empty() ? 0 : seen.size());
  const auto find = [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Vector3d p = scene.points.row(seen[i]).transpose().cast<double>() - options.origin;
      rings[i] = nearest_ring(options.lattice, rho_of(p), p.z());
    }
  };
  parallel_chunks(static_cast<std::int64_t>(rings.size()), 1024, num_threads, find, progress);
  return rings;
}

Ray ray_to(const Vector3d& point, const Vector3d& origin, double offset) {
  const Vector3d start = origin + Vector3d(0.0, 0.0, offset);
  return {start, point - start};
}

std::int64_t azimuth_index(const ScanLattice& lattice, std::size_t ring, const Vector3d& p) {
  const double angle = azimuth_of(p) - lattice.rings[ring].azimuth;
  return static_cast<std::int64_t>(std::nearbyint(angle / lattice.azimuth_step));
}

// The rings that meet the object, and a few on either side.
ScanLattice rings_towards(const ScanLattice& lattice, const Points& object,
                          const Vector3d& origin) {
  double lowest = kInfinity;
  double highest = -kInfinity;
  double nearest = kInfinity;
  double offset = 0.0;
  for (Eigen::Index i = 0; i < object.rows(); ++i) {
    const Vector3d p = object.row(i).transpose().cast<double>() - origin;
    nearest = std::min(nearest, rho_of(p));
    lowest = std::min(lowest, p.z() / rho_of(p));
    highest = std::max(highest, p.z() / rho_of(p));
  }
  for (const ScanLattice::Ring& ring : lattice.rings) {
    offset = std::max(offset, std::abs(ring.offset));
  }
  const double margin = 0.02 + offset / nearest;
  ScanLattice towards = lattice;
  std::erase_if(towards.rings, [&](const ScanLattice::Ring& ring) {
    return ring.slope < lowest - margin || ring.slope > highest + margin;
  });
  return towards;
}

// Number of azimuth steps from the cone's axis to the farther side of the object.
std::int64_t half_width(const ScanLattice& lattice, const Cone& cone, const Points& object) {
  double widest = 0.0;
  for (Eigen::Index i = 0; i < object.rows(); ++i) {
    const Vector3d p = object.row(i).transpose().cast<double>() - cone.origin;
    const double turn = std::abs(azimuth_of(p) - azimuth_of(cone.axis));
    widest = std::max(widest, std::min(turn, 2.0 * std::numbers::pi - turn));
  }
  return static_cast<std::int64_t>(widest / lattice.azimuth_step) + 2;
}

// Rays of the lattice towards the object that have no point in the scene. Their length is `reach`.
std::vector<Ray> empty_rays(const PointsView& scene, const std::vector<std::int32_t>& seen,
                            const std::vector<std::int32_t>& rings, const Cone& cone,
                            const Points& object, double reach, const InsertionOptions& options,
                            const Progress& progress) {
  std::vector<Ray> rays;
  const ScanLattice& lattice = options.lattice;
  if (lattice.rings.empty() || !(lattice.azimuth_step > 0.0)) return rays;
  const auto turn = static_cast<std::int64_t>(2.0 * std::numbers::pi / lattice.azimuth_step + 0.5);
  const auto wrapped = [&](std::int64_t i) { return ((i % turn) + turn) % turn; };
  std::vector<std::int64_t> taken;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const Vector3d p = scene.points.row(seen[i]).transpose().cast<double>() - options.origin;
    taken.push_back(rings[i] * turn + wrapped(azimuth_index(lattice, rings[i], p)));
  }
  std::sort(taken.begin(), taken.end());
  Ticker ticker(progress);
  const std::int64_t half = std::min(turn / 2, half_width(lattice, cone, object));
  for (std::size_t k = 0; k < lattice.rings.size(); ++k) {
    const std::int64_t middle = azimuth_index(lattice, k, cone.axis);
    for (std::int64_t j = -half; j <= half; ++j) {
      ticker.tick();
      const double azimuth =
          lattice.rings[k].azimuth + static_cast<double>(middle + j) * lattice.azimuth_step;
      const auto [sin, cos] = sin_cos(azimuth);
      const Ray ray(options.origin + Vector3d(0.0, 0.0, lattice.rings[k].offset),
                    Vector3d(cos, sin, lattice.rings[k].slope).normalized() * reach);
      if (!cone.holds(ray.start + ray.direction)) continue;
      const std::int64_t key = static_cast<std::int64_t>(k) * turn + wrapped(middle + j);
      if (!std::binary_search(taken.begin(), taken.end(), key)) rays.push_back(ray);
    }
  }
  return rays;
}

Vector3d hit_point(const Ray& ray, std::size_t number, const InsertionOptions& options) {
  const double noise = options.range_noise * normal(options.seed, number) / ray.direction.norm();
  return ray.start + (ray.hit + noise) * ray.direction;
}

void check_options(const InsertionOptions& options) {
  if (!options.origin.allFinite()) throw InputError("origin: expected finite numbers");
  if (!(options.range_noise >= 0.0 && std::isfinite(options.range_noise))) {
    throw InputError("range_noise: expected >= 0, got " + number_text(options.range_noise));
  }
  if (!options.lattice.rings.empty()) check_azimuths(options.lattice);
}

Points to_points(const std::vector<Vector3d>& from) {
  Points to(static_cast<Eigen::Index>(from.size()), 3);
  Eigen::Index row = 0;
  for (const Vector3d& p : from) to.row(row++) = p.cast<float>().transpose();
  return to;
}

// Moves the scene's points that the object hides onto it, and adds points for rays without a
// return. The first rays are those of the points `seen`.
Edit edit_of_hits(const RayGrid& grid, std::size_t num_rays, const std::vector<std::int32_t>& seen,
                  const InsertionOptions& options) {
  Edit edit;
  std::vector<Vector3d> moved_to, added;
  for (std::size_t i = 0; i < num_rays; ++i) {
    const Ray& ray = grid.ray(i);
    if (!(ray.hit < 1.0)) continue;
    const bool had_return = i < seen.size();
    if (had_return) edit.moved.push_back(seen[i]);
    (had_return ? moved_to : added).push_back(hit_point(ray, i, options));
  }
  edit.moved_to = to_points(moved_to);
  edit.added = to_points(added);
  if (!edit.moved_to.allFinite() || !edit.added.allFinite()) {
    throw InputError("range_noise: takes points beyond the finite floats, got " +
                     number_text(options.range_noise));
  }
  return edit;
}

}  // namespace

Forgery insert_occluding(const PointsView& scene, const PointsView& object,
                         const Eigen::Ref<const Faces>& faces, const ObjectPlacement& placement,
                         const InsertionOptions& requested, int num_threads,
                         const Progress& progress) {
  check_points(object);
  check_options(requested);
  if (faces.rows() > 0 && !(faces.minCoeff() >= 0 && faces.maxCoeff() < object.num_points())) {
    throw InputError("faces: expected indices of the object's points");
  }
  const Eigen::Matrix4d transform =
      placement_transform(scene, object, placement, num_threads, progress);
  const Points placed = transformed(object.points, transform);
  const Cone cone(requested.origin, placed);
  InsertionOptions options = requested;
  options.lattice = rings_towards(requested.lattice, placed, requested.origin);
  const std::vector<std::int32_t> seen = rows_in_cone(scene, cone, num_threads, progress);
  const std::vector<std::int32_t> rings = rings_of(scene, seen, options, num_threads, progress);
  std::vector<Ray> rays;
  rays.reserve(seen.size());
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const double offset = rings.empty() ? 0.0 : options.lattice.rings[rings[i]].offset;
    rays.push_back(
        ray_to(scene.points.row(seen[i]).transpose().cast<double>(), options.origin, offset));
  }
  double reach = 0.0;
  for (Eigen::Index i = 0; i < placed.rows(); ++i) {
    reach = std::max(reach, (placed.row(i).transpose().cast<double>() - options.origin).norm());
  }
  const std::vector<Ray> empty =
      empty_rays(scene, seen, rings, cone, placed, 2.0 * reach, options, progress);
  rays.insert(rays.end(), empty.begin(), empty.end());

  RayGrid grid(cone, rays);
  const double margin = parallax(options.lattice, placed, options.origin);
  if (faces.rows() > 0) {
    hit_faces(placed, faces, margin, progress, grid);
  } else {
    hit_discs(placed, margin, cone, num_threads, progress, grid);
  }

  Edit edit = edit_of_hits(grid, rays.size(), seen, options);
  Forgery forged = apply_edit(scene, std::move(edit), num_threads, progress);
  forged.transform = transform;
  return forged;
}

}  // namespace manip3d
