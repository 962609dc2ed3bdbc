#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "geometry/dart_board.hpp"
#include "geometry/kd_tree.hpp"
#include "manip3d/error.hpp"
#include "manip3d/forge/attacks.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/random.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;
using Order = std::vector<std::int32_t>;  // rows

constexpr std::int64_t kMaxPoints = std::int64_t{1} << 24;
constexpr double kTolerance = 0.03;  // accepted relative error of the spacing
constexpr int kCorrections = 4;
constexpr double kCandidatesPerDisk = 5.0;     // enough for a nearly full Poisson disk sampling
constexpr std::size_t kSurfaceNeighbours = 6;  // besides the point itself

Order first_of(const Order& order, double share) {
  const auto size = static_cast<std::int64_t>(order.size());
  const auto count = static_cast<std::int64_t>(share * static_cast<double>(size) + 0.5);
  Order rows(order.begin(), order.begin() + std::clamp<std::int64_t>(count, 2, size));
  std::sort(rows.begin(), rows.end());
  return rows;
}

// Changes the `length` of a sampling until the mean spacing is the wanted one. `sample(length)`
// returns rows; their `spacing_of(rows)` is about proportional to `length`.
template <typename Sample, typename Spacing>
Order with_spacing(double spacing, double length, const Sample& sample, const Spacing& spacing_of) {
  Order rows = sample(length);
  for (int i = 0; i < kCorrections && rows.size() > 2; ++i) {
    const double reached = spacing_of(rows);
    if (std::abs(reached / spacing - 1.0) <= kTolerance || !(reached > 0.0)) break;
    length *= spacing / reached;
    rows = sample(length);
  }
  return rows;
}

// Ratio of the mean spacing of a Poisson disk sampling to its radius, measured on random points of
// spheres and squares; fewer candidates give a looser sampling. It is a first guess, which
// `with_spacing` corrects; a good one saves a second sampling.
double spacing_over_radius(double gamma, bool on_faces) {
  if (gamma < 1.0) return 1.04 + 0.42 * gamma;
  return on_faces ? 1.13 : 1.25;  // interpolated points leave the gaps of their cloud open
}

void check_count(double count) {
  if (!(count >= 0.0 && count <= static_cast<double>(kMaxPoints))) {
    throw InputError("spacing: needs " + number_text(count) +
                     " points of the object's surface, at most 2^24");
  }
}

double doubled_area(const PointsView& view, const Eigen::Ref<const Faces>& faces, Eigen::Index f) {
  const Vector3d a = view.points.row(faces(f, 0)).transpose().cast<double>();
  const Vector3d b = view.points.row(faces(f, 1)).transpose().cast<double>();
  const Vector3d c = view.points.row(faces(f, 2)).transpose().cast<double>();
  return (b - a).cross(c - a).norm();
}

Vector3d on_triangle(const Vector3d& a, const Vector3d& b, const Vector3d& c, std::uint64_t seed,
                     std::uint64_t counter) {
  double u = uniform(seed, 2 * counter);
  double v = uniform(seed, 2 * counter + 1);
  if (u + v > 1.0) {  // reflect from the other half of the parallelogram
    u = 1.0 - u;
    v = 1.0 - v;
  }
  return a + u * (b - a) + v * (c - a);
}

// Random points on the faces, `density` per unit of area.
Points surface_candidates(const PointsView& view, const Eigen::Ref<const Faces>& faces,
                          double density, std::uint64_t seed, const Progress& progress) {
  Ticker ticker(progress);
  double area = 0.0;
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    ticker.tick();
    area += 0.5 * doubled_area(view, faces, f);
  }
  check_count(area * density);
  Points samples(static_cast<Eigen::Index>(area * density) + 1, 3);
  Eigen::Index row = 0;
  double due = 0.0;
  for (Eigen::Index f = 0; f < faces.rows() && row < samples.rows(); ++f) {
    ticker.tick();
    due += 0.5 * doubled_area(view, faces, f) * density;
    const auto corner = [&](int k) -> Vector3d {
      return view.points.row(faces(f, k)).transpose().cast<double>();
    };
    for (; static_cast<double>(row) < due && row < samples.rows(); ++row) {
      ticker.tick();
      samples.row(row) =
          on_triangle(corner(0), corner(1), corner(2), seed, static_cast<std::uint64_t>(row))
              .cast<float>();
    }
  }
  return samples.topRows(row);
}

// Two different rows; twice the same if there is one only.
std::pair<std::uint32_t, std::uint32_t> two_of(const std::vector<std::uint32_t>& rows,
                                               std::uint64_t seed, std::uint64_t counter) {
  const std::size_t first = random_bits(seed, 2 * counter) % rows.size();
  if (rows.size() == 1) return {rows[0], rows[0]};
  std::size_t second = random_bits(seed, 2 * counter + 1) % (rows.size() - 1);
  if (second >= first) ++second;  // a number of those that are left
  return {rows[first], rows[second]};
}

// Each point, and random points on triangles of it and two of its neighbours; on the segment to its
// neighbour if there is one only.
Points cloud_candidates(const PointsView& object, double per_point, const ResampleOptions& options,
                        const Progress& progress) {
  const Points places = distinct(object);  // neighbours at one place span no triangle
  const PointsView view = view_of(places);
  check_count(static_cast<double>(view.num_points()) * (std::ceil(per_point) + 1.0));
  const auto share = static_cast<Eigen::Index>(std::ceil(per_point));
  const KdTree tree(view, progress);
  Points samples(view.num_points() * (share + 1), 3);
  parallel_chunks(
      view.num_points(), 256, options.num_threads,
      [&](std::int64_t begin, std::int64_t end) {
        KdTree::Neighbours near;
        for (std::int64_t i = begin; i < end; ++i) {
          tree.nearest(i, kSurfaceNeighbours + 1, near);
          std::erase(near.rows, static_cast<std::uint32_t>(i));
          const auto point = [&](std::int64_t row) -> Vector3d {
            return view.points.row(row).transpose().cast<double>();
          };
          Eigen::Index row = i * (share + 1);
          samples.row(row++) = view.points.row(i);
          for (Eigen::Index k = 0; k < share; ++k, ++row) {
            const auto counter = static_cast<std::uint64_t>(row);
            const auto [b, c] = two_of(near.rows, options.seed + 1, counter);
            samples.row(row) =
                on_triangle(point(i), point(b), point(c), options.seed, counter).cast<float>();
          }
        }
      },
      part_of(progress, 0.0, 0.0));
  return samples;
}

// More points than the wanted ones, on the faces if there are any.
Points interpolated(const PointsView& object, const Eigen::Ref<const Faces>& faces, double gamma,
                    const ResampleOptions& options, const Progress& progress) {
  if (faces.rows() == 0) {
    return cloud_candidates(object, kCandidatesPerDisk * gamma * gamma, options, progress);
  }
  const double density = kCandidatesPerDisk / (options.spacing * options.spacing);
  return surface_candidates(object, faces, density, options.seed, progress);
}

Points thinned_at_random(const PointsView& object, double spacing_of_object,
                         const ResampleOptions& options, const Progress& progress) {
  Ticker ticker(progress);
  const Order order = random_order(object.num_points(), options.seed, ticker);
  const auto sample = [&](double length) {
    const double share = spacing_of_object / length;
    return first_of(order, std::min(1.0, share * share));
  };
  const auto spacing_of = [&](const Order& rows) {
    return mean_spacing(view_of(take(object, rows)), progress);
  };
  return take(object, with_spacing(options.spacing, options.spacing, sample, spacing_of));
}

// The argument of the Python functions that names the object is `hoax`.
void check_object(const PointsView& object, const Eigen::Ref<const Faces>& faces, double spacing) {
  check_points(object);
  if (faces.rows() > 0 && !(faces.minCoeff() >= 0 && faces.maxCoeff() < object.num_points())) {
    throw InputError("faces: expected indices of the object's " +
                     std::to_string(object.num_points()) + " points");
  }
  if (!(spacing > 0.0 && std::isfinite(spacing))) {
    throw InputError("spacing: expected > 0, got " + number_text(spacing));
  }
  if (object.num_points() < 2) {
    throw InputError("hoax: expected at least 2 points, got " +
                     std::to_string(object.num_points()));
  }
  if (!(object.points.cwiseAbs().maxCoeff() < spacing * 0x1p40)) {
    throw InputError("spacing: expected one within 2^40 of the largest coordinate, got " +
                     number_text(spacing));
  }
}

}  // namespace

Points resample(const PointsView& object, const Eigen::Ref<const Faces>& faces,
                const ResampleOptions& options, const Progress& progress) {
  check_object(object, faces, options.spacing);
  const double spacing = options.spacing;
  const double spacing_of_object = mean_spacing(object, progress);
  if (!(spacing_of_object > 0.0)) throw InputError("hoax: expected points at different places");
  const double gamma = spacing_of_object / spacing;
  if (gamma < 1.0 && options.method == Resampling::kUniform) {
    return thinned_at_random(object, spacing_of_object, options, progress);
  }
  Points made;
  if (gamma >= 1.0) made = interpolated(object, faces, gamma, options, progress);
  if (gamma >= 1.0 && made.rows() < 2) return made;
  const PointsView candidates = gamma < 1.0 ? object : view_of(made);
  DartBoard board(candidates, options.seed + 2, Vector3d::Zero(), progress);
  const double first_radius = spacing / spacing_over_radius(gamma, faces.rows() > 0);
  return take(candidates,
              with_spacing(
                  spacing, first_radius, [&](double radius) { return board.sample(radius); },
                  [&](const Order& rows) { return board.mean_spacing_of(rows); }));
}

}  // namespace manip3d
