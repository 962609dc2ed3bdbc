#include "manip3d/forge/attacks.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "geometry/dart_board.hpp"
#include "geometry/kd_tree.hpp"
#include "geometry/select_rows.hpp"
#include "geometry/small_solvers.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/angles.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix4d;
using Eigen::Vector3d;

constexpr std::size_t kNormalNeighbours = 12;  // with fewer, the plane fits the range noise

Vector3d sum_of(const PointsView& view, std::int64_t begin, std::int64_t end) {
  Vector3d sum = Vector3d::Zero();
  for (std::int64_t i = begin; i < end; ++i) {
    sum += view.points.row(i).transpose().cast<double>();
  }
  return sum;
}

// All points of an object: one of them may be its own origin.
Vector3d centroid_of_object(const PointsView& object) {
  Vector3d total = Vector3d::Zero();
  for (std::int64_t begin = 0; begin < object.num_points(); begin += kPointChunk) {
    total += sum_of(object, begin, std::min(begin + kPointChunk, object.num_points()));
  }
  return total / static_cast<double>(std::max<std::int64_t>(object.num_points(), 1));
}

// The points of a scan, without firings that met nothing.
Vector3d centroid_of_returns(const PointsView& scan, int num_threads, const Progress& progress) {
  struct Part {
    Vector3d sum;
    std::int64_t num_returns = 0;
  };
  const std::int64_t count = scan.num_points();
  std::vector<Part> parts((count + kPointChunk - 1) / kPointChunk);
  parallel_chunks(
      count, kPointChunk, num_threads,
      [&](std::int64_t begin, std::int64_t end) {
        Part& part = parts[begin / kPointChunk];
        part.sum = sum_of(scan, begin, end);
        for (std::int64_t i = begin; i < end; ++i) {
          const auto p = scan.points.row(i);
          part.num_returns += !is_no_return(p.x(), p.y(), p.z());
        }
      },
      progress);
  Part all{Vector3d::Zero()};
  for (const Part& part : parts) {
    all.sum += part.sum;
    all.num_returns += part.num_returns;
  }
  return all.sum / static_cast<double>(std::max<std::int64_t>(all.num_returns, 1));
}

bool is_rotation(const Matrix3d& r) {
  return (r * r.transpose() - Matrix3d::Identity()).cwiseAbs().maxCoeff() <= 1e-6 &&
         r.determinant() > 0.0;
}

// uniform in the unit ball, by rejection sampling
Vector3d in_ball(std::uint64_t seed, std::uint64_t row) {
  for (std::uint64_t trial = 0;; ++trial) {
    const std::uint64_t counter = 3 * (64 * row + trial);
    const Vector3d v(2.0 * uniform(seed, counter) - 1.0, 2.0 * uniform(seed, counter + 1) - 1.0,
                     2.0 * uniform(seed, counter + 2) - 1.0);
    if (v.squaredNorm() <= 1.0 || trial == 63) return v / std::max(1.0, v.norm());
  }
}

// Normal of the plane through a point's neighbours, towards the scanner; zero if there are too few
// neighbours.
Vector3d surface_normal(const Points& points, const KdTree& tree, Eigen::Index row,
                        const Vector3d& origin, KdTree::Neighbours& near) {
  tree.nearest(row, kNormalNeighbours, near);
  if (near.rows.size() < 3) return Vector3d::Zero();
  Vector3d mean = Vector3d::Zero();
  for (const std::uint32_t r : near.rows) mean += points.row(r).transpose().cast<double>();
  mean /= static_cast<double>(near.rows.size());
  Matrix3d covariance = Matrix3d::Zero();
  for (const std::uint32_t r : near.rows) {
    const Vector3d d = points.row(r).transpose().cast<double>() - mean;
    covariance += d * d.transpose();
  }
  const Vector3d normal = principal_axes(covariance).directions.col(0);
  const Vector3d to_scanner = origin - points.row(row).transpose().cast<double>();
  return normal.dot(to_scanner) < 0.0 ? Vector3d(-normal) : normal;
}

// Relative depth of a dent: 1 in the middle of the box, 0 on its border and outside.
double dent_profile(const Vector3d& point, const OrientedBox& box, const Matrix3d& to_box) {
  const Vector3d p = to_box * (point - box.center);
  double squared = 0.0;
  for (int axis = 0; axis < 3; ++axis) {
    if (box.size[axis] > 0.0) {
      const double d = 2.0 * p[axis] / box.size[axis];
      squared += d * d;
    }
  }
  const double rest = std::max(0.0, 1.0 - squared);
  return rest * rest;
}

std::vector<Vector3d> displacements(const PointsView& scene, const std::vector<std::int32_t>& rows,
                                    const OrientedBox& box, const DeformOptions& options,
                                    int num_threads, const Progress& progress) {
  std::vector<Vector3d> moves(rows.size());
  if (options.direction == Displacement::kRandom) {
    for (std::size_t i = 0; i < rows.size(); ++i) {
      moves[i] = options.amplitude * in_ball(options.seed, static_cast<std::uint64_t>(rows[i]));
    }
    return moves;
  }
  const Points points = take(scene, rows);
  const KdTree tree(view_of(points), progress);
  const Matrix3d to_box = rotation_about_z(box.yaw).transpose();
  const auto count = static_cast<std::int64_t>(rows.size());
  const auto displace = [&](std::int64_t begin, std::int64_t end) {
    KdTree::Neighbours near;
    for (std::int64_t i = begin; i < end; ++i) {
      const Vector3d p = points.row(i).transpose().cast<double>();
      const double depth = options.amplitude * dent_profile(p, box, to_box);
      moves[i] = Vector3d::Zero();
      if (depth != 0.0) moves[i] = -depth * surface_normal(points, tree, i, options.origin, near);
    }
  };
  parallel_chunks(count, 256, num_threads, displace, progress);
  return moves;
}

// Sum over the points within a radius: distances to their nearest neighbours.
struct NearSpacing {
  double sum = 0.0;
  std::int64_t count = 0;
  bool is_sure = true;  // no nearer neighbour can be outside of the reach
};

// Points at one place count once: some scans store each point twice.
// @param near  the points of the scene within `reach` of the position.
NearSpacing spacing_near(const Points& near, const Vector3d& position, double radius, double reach,
                         const Progress& progress) {
  NearSpacing spacing;
  const KdTree tree(view_of(near), progress);
  Ticker ticker(progress);
  for (Eigen::Index i = 0; i < near.rows(); ++i) {
    ticker.tick();
    const Vector3d p = near.row(i).transpose().cast<double>();
    const double squared = (p - position).squaredNorm();
    if (!(squared <= radius * radius)) continue;
    const double distance = tree.nearest_distance(i);
    if (distance == 0.0)
      return spacing_near(distinct(view_of(near)), position, radius, reach, progress);
    spacing.is_sure = spacing.is_sure && distance + std::sqrt(squared) <= (1.0 - 1e-9) * reach;
    if (!std::isfinite(distance)) continue;
    spacing.sum += distance;
    ++spacing.count;
  }
  return spacing;
}

}  // namespace

Matrix4d placement_transform(const PointsView& scene, const PointsView& object,
                             const ObjectPlacement& placement, int num_threads,
                             const Progress& progress) {
  if (!placement.position.allFinite()) throw InputError("position: expected finite numbers");
  if (!(placement.scale > 0.0 && std::isfinite(placement.scale))) {
    throw InputError("scale: expected > 0, got " + number_text(placement.scale));
  }
  if (!is_rotation(placement.rotation)) {
    throw InputError("rotation: expected a rotation matrix");
  }
  if (object.num_points() == 0) throw InputError("hoax: expected points, got none");
  const Matrix3d linear = placement.scale * placement.rotation;
  const Vector3d o_object = centroid_of_object(object);
  Matrix4d transform = Matrix4d::Identity();
  transform.topLeftCorner<3, 3>() = linear;
  if (placement.translation == Translation::kPaper) {
    const Vector3d o_scene = centroid_of_returns(scene, num_threads, progress);
    transform.topRightCorner<3, 1>() = placement.position - (o_scene - o_object);
  } else {
    transform.topRightCorner<3, 1>() = placement.position - linear * o_object;
  }
  return transform;
}

Points transformed(const Eigen::Ref<const Points>& points, const Matrix4d& transform,
                   const std::vector<std::int32_t>& rows) {
  const Matrix3d linear = transform.topLeftCorner<3, 3>();
  const Vector3d translation = transform.topRightCorner<3, 1>();
  Points result(points.rows(), 3);
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    const Vector3d p = linear * points.row(i).transpose().cast<double>() + translation;
    result.row(i) = p.cast<float>();
    if (!result.row(i).allFinite()) {
      const Eigen::Index row = rows.empty() ? i : rows[static_cast<std::size_t>(i)];
      throw InputError("transform: takes row " + std::to_string(row) + " beyond the finite floats");
    }
  }
  return result;
}

Forgery copy_transform_paste(const PointsView& scene, const PointsView& object,
                             const ObjectPlacement& placement, int num_threads,
                             const Progress& progress) {
  check_points_everywhere(scene, num_threads, progress);
  check_points(object);
  const Matrix4d transform = placement_transform(scene, object, placement, num_threads, progress);
  Edit edit;
  edit.added = transformed(object.points, transform);
  edit.added_intensity = object.intensity;
  Forgery forged = apply_edit(scene, std::move(edit), num_threads, progress);
  forged.transform = transform;
  return forged;
}

double local_spacing(const PointsView& scene, const Vector3d& position, double radius,
                     int num_threads, const Progress& progress) {
  if (!position.allFinite()) throw InputError("position: expected finite numbers");
  if (!(radius > 0.0 && std::isfinite(radius))) {
    throw InputError("radius: expected > 0, got " + number_text(radius));
  }
  // Points near the border have neighbours outside of the radius. Twice the radius contains the
  // nearest neighbour of each point that has one within the radius; 1.125 times mostly suffices.
  NearSpacing spacing;
  for (const double reach : {1.125 * radius, 2.0 * radius}) {
    const auto within = [&](float x, float y, float z) {
      return (Vector3d(x, y, z) - position).squaredNorm() <= reach * reach &&
             !is_no_return(x, y, z);
    };
    spacing = spacing_near(take(scene, select_rows(scene, num_threads, within, progress)), position,
                           radius, reach, progress);
    if (spacing.is_sure) break;
  }
  if (spacing.count < 2) {
    throw InputError("position: expected scene points within " + number_text(radius) +
                     " m at different places, whose spacing the object takes; got " +
                     std::to_string(spacing.count));
  }
  return spacing.sum / static_cast<double>(spacing.count);
}

Forgery subtract(const PointsView& scene, const OrientedBox& box, int num_threads,
                 const Progress& progress) {
  Edit edit;
  edit.removed = points_in_box(scene, box, num_threads, progress);
  return apply_edit(scene, std::move(edit), num_threads, progress);
}

Forgery replace_rows(const PointsView& scene, std::vector<std::int32_t> rows,
                     const PointsView& added, int num_threads, const Progress& progress) {
  check_points_everywhere(scene, num_threads, progress);
  check_points(added);
  Edit edit;
  edit.removed = checked_rows(std::move(rows), scene.num_points());
  edit.added = added.points;
  edit.added_intensity = added.intensity;
  return apply_edit(scene, std::move(edit), num_threads, progress);
}

Forgery deform(const PointsView& scene, const OrientedBox& box, const DeformOptions& options,
               int num_threads, const Progress& progress) {
  if (!std::isfinite(options.amplitude)) throw InputError("amplitude: expected a finite number");
  if (!options.origin.allFinite()) throw InputError("origin: expected finite numbers");
  Edit edit;
  edit.moved = points_in_box(scene, box, num_threads, progress);
  const std::vector<Vector3d> moves =
      displacements(scene, edit.moved, box, options, num_threads, progress);
  edit.moved_to = take(scene, edit.moved);
  for (std::size_t i = 0; i < moves.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    const Vector3d p = edit.moved_to.row(row).transpose().cast<double>() + moves[i];
    edit.moved_to.row(row) = p.cast<float>();
  }
  if (!edit.moved_to.allFinite()) throw InputError("amplitude: takes points beyond finite floats");
  return apply_edit(scene, std::move(edit), num_threads, progress);
}

Forgery move_box(const PointsView& scene, const OrientedBox& box, const Matrix4d& transform,
                 int num_threads, const Progress& progress) {
  const bool affine = transform.row(3) == Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0);
  if (!(transform.allFinite() && affine && is_rotation(transform.topLeftCorner<3, 3>()))) {
    throw InputError("transform: expected a rotation and a translation");
  }
  Edit edit;
  edit.moved = points_in_box(scene, box, num_threads, progress);
  edit.moved_to = transformed(take(scene, edit.moved), transform, edit.moved);
  Forgery forged = apply_edit(scene, std::move(edit), num_threads, progress);
  forged.transform = transform;
  return forged;
}

}  // namespace manip3d
