#include "manip3d/metrics/hausdorff.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/patch_distance.hpp"
#include "metrics/common.hpp"

namespace manip3d {
namespace {

using Eigen::Vector3d;

// Largest rounding error of a distance between meshes scaled to size 1.
constexpr double kRounding = 1e-13;
// Smallest tolerance, as a share of the size: parts that are halved as far as that still differ.
constexpr double kLeastTolerance = 1e-12;
// A patch is evaluated if its reach is at most this many of its longest edges.
constexpr double kNearFaces = 3.0;

struct Bounds {
  double lower = 0.0;
  double upper = 0.0;
  void add(const Bounds& other) {
    lower = std::max(lower, other.lower);
    upper = std::max(upper, other.upper);
  }
};

Triangle3 corners_of(const MeshView& mesh, std::int64_t face) {
  Triangle3 corners;
  for (int k = 0; k < 3; ++k) corners[k] = mesh.vertices.row(mesh.faces(face, k));
  return corners;
}

/// Largest coordinate of a mesh.
double extent_of(const MeshView& mesh) {
  const BoundingBox box = bounding_box(mesh);
  return box.max.cwiseAbs().cwiseMax(box.min.cwiseAbs()).maxCoeff();
}

/// Size of the larger mesh, relative to the original: rounding errors grow with it.
double relative_size(const NormalizedPair& pair) {
  const double extent = std::max(extent_of(pair.original()), extent_of(pair.simplified()));
  return std::max(1.0, extent / pair.diagonal());
}

int longest_edge(const Triangle3& t) {
  int longest = 0;
  for (int k = 1; k < 3; ++k) {
    if ((t[(k + 1) % 3] - t[k]).squaredNorm() > (t[(longest + 1) % 3] - t[longest]).squaredNorm()) {
      longest = k;
    }
  }
  return longest;
}

double length_of_edge(const Triangle3& t, int k) { return (t[(k + 1) % 3] - t[k]).norm(); }

/// Computes bounds for triangles of one surface, one after the other.
class TriangleBounds {
 public:
  TriangleBounds(const MeshView& surface, const TriangleBvh& bvh, double lower, double tolerance)
      : surface_(surface), bvh_(bvh), lower_(lower), tolerance_(tolerance) {}

  Bounds measure(const Triangle3& triangle) {
    Bounds result{lower_, 0.0};
    parts_.assign(1, triangle);
    while (!parts_.empty()) {
      const Triangle3 part = parts_.back();
      parts_.pop_back();
      const double upper = bound_part(part, result.lower);
      if (upper <= result.lower + tolerance_) {
        result.upper = std::max(result.upper, upper);
        continue;
      }
      const int k = longest_edge(part);
      const Vector3d middle = 0.5 * (part[k] + part[(k + 1) % 3]);
      parts_.push_back(part);
      parts_.back()[k] = middle;
      parts_.push_back(part);
      parts_.back()[(k + 1) % 3] = middle;
    }
    return result;
  }

 private:
  double bound_part(const Triangle3& part, double& lower) {
    const Vector3d center = (part[0] + part[1] + part[2]) / 3.0;
    double radius = 0.0;
    for (const Vector3d& corner : part) radius = std::max(radius, (corner - center).norm());
    const SurfacePoint nearest = bvh_.closest_point(center, near_face_);
    near_face_ = nearest.face;
    lower = std::max(lower, nearest.distance);
    const double by_radius = nearest.distance + radius;
    if (by_radius <= lower + tolerance_) return by_radius;
    const Triangle3 face = corners_of(surface_, nearest.face);
    // Distance within which the nearest faces of all points of the part are.
    const double reach = nearest.distance + 2.0 * radius;
    if (reach > kNearFaces * length_of_edge(face, longest_edge(face))) return by_radius;
    bvh_.faces_within(center, reach * (1.0 + 1e-9), found_);
    patch_.clear();
    for (const SurfacePoint& other : found_) {
      patch_.push_back({corners_of(surface_, other.face), 0.0});
    }
    return std::min(by_radius, distance_.bound(part, patch_, lower + tolerance_));
  }

  const MeshView& surface_;
  const TriangleBvh& bvh_;
  const double lower_, tolerance_;
  std::int32_t near_face_ = 0;
  std::vector<Triangle3> parts_;
  std::vector<SurfacePoint> found_;
  std::vector<PatchTriangle> patch_;
  PatchDistance distance_;
};

/// Bounds of a distance whose rounding error is at most `rounding`.
Bounds one_sided(const MeshView& from, const MeshView& to, double tolerance, double rounding,
                 int num_threads, const Progress& progress) {
  const TriangleBvh bvh(to, part_of(progress, 0.0, 0.1));
  // First finds a large lower bound, because parts nearer than it need no evaluation.
  const auto lower_of = [&](std::int64_t begin, std::int64_t end) {
    Bounds bounds;
    std::int32_t near_face = 0;
    for (std::int64_t f = begin; f < end; ++f) {
      for (const Vector3d& corner : corners_of(from, f)) {
        const SurfacePoint nearest = bvh.closest_point(corner, near_face);
        near_face = nearest.face;
        bounds.lower = std::max(bounds.lower, nearest.distance);
      }
    }
    return bounds;
  };
  const double lower = accumulate_in_order<Bounds>(from.num_faces(), num_threads,
                                                   part_of(progress, 0.1, 0.3), lower_of)
                           .lower;
  const auto bound_of = [&](std::int64_t begin, std::int64_t end) {
    TriangleBounds triangles(to, bvh, lower, tolerance);
    Bounds bounds;
    for (std::int64_t f = begin; f < end; ++f) bounds.add(triangles.measure(corners_of(from, f)));
    return bounds;
  };
  Bounds result = accumulate_in_order<Bounds>(from.num_faces(), num_threads,
                                              part_of(progress, 0.3, 1.0), bound_of);
  result.upper = std::max(result.upper, result.lower) + rounding;
  return result;
}

}  // namespace

HausdorffResult hausdorff_bound(const MeshView& original, const MeshView& simplified,
                                const HausdorffOptions& options, const Progress& progress) {
  if (!(options.tolerance > 0.0)) {
    throw InputError("tolerance: expected > 0, got " + number_text(options.tolerance));
  }
  const NormalizedPair pair(original, simplified);
  const double size = relative_size(pair);
  if (!(options.tolerance >= kLeastTolerance * size)) {
    throw InputError("tolerance: expected at least " + number_text(kLeastTolerance * size) +
                     " for meshes of these sizes, got " + number_text(options.tolerance));
  }
  const double tolerance = options.tolerance * pair.diagonal();
  const auto measure = [&](const MeshView& from, const MeshView& to, double start) {
    const Bounds bounds = one_sided(from, to, tolerance, kRounding * size, options.num_threads,
                                    part_of(progress, start, start + 0.5));
    return DistanceBounds{bounds.lower * pair.unit(), bounds.upper * pair.unit()};
  };
  HausdorffResult result;
  result.diagonal = pair.diagonal() * pair.unit();
  result.forward = measure(pair.original(), pair.simplified(), 0.0);
  result.backward = measure(pair.simplified(), pair.original(), 0.5);
  return result;
}

}  // namespace manip3d
