#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include "forge/spatial_hash.hpp"
#include "geometry/kd_tree.hpp"
#include "manip3d/error.hpp"
#include "manip3d/forge/attacks.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;
using Order = std::vector<std::int32_t>;

constexpr std::int64_t kMostPoints = std::int64_t{1} << 24;
constexpr std::int64_t kProbes = 2048;  // their mean spacing is good to about 1 %
constexpr double kTolerance = 0.03;     // of the spacing reached
constexpr int kCorrections = 4;
constexpr double kCandidatesPerDisk = 5.0;  // a Poisson disk sampling is nearly full with these
constexpr std::size_t kSurfaceNeighbours = 6;

PointsView view_of(const Points& points) { return PointsView({points.data(), points.rows(), 3}); }

// Mean nearest-neighbour distance, of a few thousand of the points.
double mean_spacing(const Points& points) {
  const KdTree tree(view_of(points));
  const std::int64_t step = std::max<std::int64_t>(1, points.rows() / kProbes);
  double sum = 0.0;
  std::int64_t count = 0;
  for (std::int64_t i = 0; i < points.rows(); i += step, ++count) sum += tree.nearest_distance(i);
  return sum / static_cast<double>(count);
}

Order random_order(std::int64_t count, std::uint64_t seed) {
  std::vector<std::uint64_t> keys(static_cast<std::size_t>(count));
  for (std::size_t i = 0; i < keys.size(); ++i) keys[i] = random_bits(seed, i);
  Order order(keys.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    return std::pair(keys[a], a) < std::pair(keys[b], b);
  });
  return order;
}

Points take(const Points& points, Order rows) {
  std::sort(rows.begin(), rows.end());
  Points taken(static_cast<Eigen::Index>(rows.size()), 3);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    taken.row(static_cast<Eigen::Index>(i)) = points.row(rows[i]);
  }
  return taken;
}

// Dart throwing [Cook, ACM TOG 1986] among given points, in the given order: a point stays unless
// one that stayed is nearer than the radius.
Points poisson_disk(const Points& points, const Order& order, double radius) {
  SpatialHash hash(radius);
  Order kept;
  for (const std::int32_t row : order) {
    const Vector3d p = points.row(row).transpose().cast<double>();
    const SpatialHash::Cell cell = hash.cell_of(p);
    const auto too_near = [&](std::int32_t item) {
      return (points.row(kept[item]).transpose().cast<double>() - p).squaredNorm() <
             radius * radius;
    };
    bool free = !hash.any(cell, too_near);  // mostly it is there
    for (int i = 0; i < 27 && free; ++i) {
      const SpatialHash::Cell offset(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1);
      free = i == 13 || !hash.any(cell + offset, too_near);
    }
    if (!free) continue;
    hash.insert(cell);
    kept.push_back(row);
  }
  return take(points, std::move(kept));
}

Points first_of(const Points& points, const Order& order, double share) {
  const auto count = static_cast<std::int64_t>(share * static_cast<double>(order.size()) + 0.5);
  const std::int64_t kept = std::clamp<std::int64_t>(count, 2, points.rows());
  return take(points, Order(order.begin(), order.begin() + kept));
}

// Changes a sampling's `length` until the mean spacing is the wanted one. `sample(length)` gives
// points whose spacing is about proportional to it.
template <typename Sample>
Points with_spacing(double spacing, double length, const Sample& sample) {
  Points points = sample(length);
  for (int i = 0; i < kCorrections && points.rows() > 2; ++i) {
    const double reached = mean_spacing(points);
    if (std::abs(reached / spacing - 1.0) <= kTolerance || !(reached > 0.0)) break;
    length *= spacing / reached;
    points = sample(length);
  }
  return points;
}

void check_count(double count) {
  if (!(count <= static_cast<double>(kMostPoints))) {
    throw InputError(
        "spacing: expected one that 2^24 points of the object's surface can have, "
        "this wants " +
        std::to_string(count));
  }
}

double doubled_area(const Points& points, const Eigen::Ref<const Faces>& faces, Eigen::Index f) {
  const Vector3d a = points.row(faces(f, 0)).transpose().cast<double>();
  const Vector3d b = points.row(faces(f, 1)).transpose().cast<double>();
  const Vector3d c = points.row(faces(f, 2)).transpose().cast<double>();
  return (b - a).cross(c - a).norm();
}

Vector3d on_triangle(const Vector3d& a, const Vector3d& b, const Vector3d& c, std::uint64_t seed,
                     std::uint64_t counter) {
  double u = uniform(seed, 2 * counter);
  double v = uniform(seed, 2 * counter + 1);
  if (u + v > 1.0) {  // the other half of the parallelogram
    u = 1.0 - u;
    v = 1.0 - v;
  }
  return a + u * (b - a) + v * (c - a);
}

// Random points of the faces, `density` per unit of area.
Points surface_candidates(const Points& points, const Eigen::Ref<const Faces>& faces,
                          double density, std::uint64_t seed) {
  double area = 0.0;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) area += 0.5 * doubled_area(points, faces, f);
  check_count(area * density);
  Points samples(static_cast<Eigen::Index>(area * density) + 1, 3);
  Eigen::Index row = 0;
  double due = 0.0;
  for (Eigen::Index f = 0; f < faces.rows() && row < samples.rows(); ++f) {
    due += 0.5 * doubled_area(points, faces, f) * density;
    const auto corner = [&](int k) -> Vector3d {
      return points.row(faces(f, k)).transpose().cast<double>();
    };
    for (; static_cast<double>(row) < due && row < samples.rows(); ++row) {
      samples.row(row) =
          on_triangle(corner(0), corner(1), corner(2), seed, static_cast<std::uint64_t>(row))
              .cast<float>();
    }
  }
  return samples.topRows(row);
}

// Random points of the triangles between each point and pairs of its neighbours.
Points cloud_candidates(const Points& points, double per_point, std::uint64_t seed) {
  const auto share = static_cast<Eigen::Index>(std::ceil(per_point));
  check_count(static_cast<double>(points.rows()) * static_cast<double>(share + 1));
  const KdTree tree(view_of(points));
  Points samples(points.rows() * (share + 1), 3);
  KdTree::Neighbours near;
  Eigen::Index row = 0;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    samples.row(row++) = points.row(i);
    tree.nearest(i, kSurfaceNeighbours, near);
    const std::uint64_t count = near.rows.size();
    for (Eigen::Index k = 0; k < share; ++k, ++row) {
      const auto counter = static_cast<std::uint64_t>(row);
      const auto pick = [&](std::uint64_t n) -> Vector3d {
        const std::uint64_t which = random_bits(seed + 1, 2 * counter + n) % count;
        return points.row(near.rows[which]).transpose().cast<double>();
      };
      const Vector3d p = points.row(i).transpose().cast<double>();
      samples.row(row) = on_triangle(p, pick(0), pick(1), seed, counter).cast<float>();
    }
  }
  return samples;
}

void check_faces(const Eigen::Ref<const Faces>& faces, std::int64_t num_points) {
  if (faces.rows() > 0 && !(faces.minCoeff() >= 0 && faces.maxCoeff() < num_points)) {
    throw InputError("faces: expected indices of the object's " + std::to_string(num_points) +
                     " points");
  }
}

}  // namespace

Points resample(const PointsView& object, const Eigen::Ref<const Faces>& faces,
                const ResampleOptions& options) {
  check_points(object);
  check_faces(faces, object.num_points());
  const double spacing = options.spacing;
  if (!(spacing > 0.0 && std::isfinite(spacing))) {
    throw InputError("spacing: expected > 0, got " + std::to_string(spacing));
  }
  if (object.num_points() < 2) {
    throw InputError("hoax: expected at least 2 points, got " +
                     std::to_string(object.num_points()));
  }
  const Points points = object.points;
  if (!(points.cwiseAbs().maxCoeff() < spacing * 0x1p40)) {
    throw InputError("spacing: expected one within 2^40 of the largest coordinate, got " +
                     std::to_string(spacing));
  }
  const double spacing_of_object = mean_spacing(points);
  if (!(spacing_of_object > 0.0)) {
    throw InputError("hoax: expected points at different places");
  }
  const double gamma = spacing_of_object / spacing;
  if (gamma < 1.0 && options.method == Resampling::kUniform) {
    const Order order = random_order(points.rows(), options.seed);
    return with_spacing(spacing, spacing, [&](double length) {
      const double share = spacing_of_object / length;
      return first_of(points, order, std::min(1.0, share * share));
    });
  }
  Points candidates = points;
  if (gamma >= 1.0 && faces.rows() > 0) {
    candidates =
        surface_candidates(points, faces, kCandidatesPerDisk / (spacing * spacing), options.seed);
  } else if (gamma >= 1.0) {
    candidates = cloud_candidates(points, kCandidatesPerDisk * gamma * gamma, options.seed);
  }
  if (candidates.rows() < 2) return candidates;
  const Order order = random_order(candidates.rows(), options.seed + 2);
  const double first_radius = 0.85 * spacing;  // disks do not touch: neighbours are farther apart
  return with_spacing(spacing, first_radius,
                      [&](double radius) { return poisson_disk(candidates, order, radius); });
}

}  // namespace manip3d
