#include "manip3d/geometry/triangulate_polygon.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::int64_t kTestsPerCorner = 128;
// Rounding error of a cross product of points in the unit cube; below it, three points are
// collinear.
constexpr double kInLine = 1e-15;

// Scaling by a power of two is exact, so collinear points stay collinear.
std::vector<Vector3d>& scale_to_unit(std::vector<Vector3d>& points) {
  double largest = 0.0;
  for (const Vector3d& p : points) largest = std::max(largest, p.cwiseAbs().maxCoeff());
  if (!(largest > 0.0)) return points;
  const int exponent = std::ilogb(largest) + 2;  // halves at most, so that differences fit as well
  for (Vector3d& p : points) {
    p = p.unaryExpr([&](double x) { return std::ldexp(x, -exponent); });
  }
  const Vector3d origin = points.front();
  for (Vector3d& p : points) p -= origin;
  return points;
}

// Newell's normal: twice the area vector of the polygon.
Vector3d newell_normal(const std::vector<Vector3d>& points) {
  Vector3d normal = Vector3d::Zero();
  for (std::size_t i = 0; i < points.size(); ++i) {
    normal += points[i].cross(points[(i + 1) % points.size()]);
  }
  return normal;
}

}  // namespace

std::span<const PolygonTriangulator::Triangle> PolygonTriangulator::triangulate(
    std::span<const Vector3d> corners) {
  triangles_.clear();
  if (corners.size() == 3) {
    triangles_.push_back({0, 1, 2});
    return triangles_;
  }
  points_.assign(corners.begin(), corners.end());
  const Vector3d normal = newell_normal(scale_to_unit(points_));
  if (corners.size() == 4) {
    cut_quad(normal);
  } else {
    clip_ears(normal);
  }
  return triangles_;
}

void PolygonTriangulator::cut_quad(const Vector3d& normal) {
  const auto faces_normal = [&](int a, int b, int c) {
    const auto& p = points_;
    const auto at = [](int i) { return static_cast<std::size_t>(i); };
    return normal.dot((p[at(b)] - p[at(a)]).cross(p[at(c)] - p[at(a)])) > 0.0;
  };
  const bool first_fits = faces_normal(0, 1, 2) && faces_normal(0, 2, 3);
  const bool second_fits = faces_normal(0, 1, 3) && faces_normal(1, 2, 3);
  const double first_length = (points_[2] - points_[0]).squaredNorm();
  const double second_length = (points_[3] - points_[1]).squaredNorm();
  const bool second = first_fits == second_fits ? second_length < first_length : second_fits;
  if (second) {
    triangles_ = {{0, 1, 3}, {1, 2, 3}};
  } else {
    triangles_ = {{0, 1, 2}, {0, 2, 3}};
  }
}

void PolygonTriangulator::clip_ears(const Vector3d& normal) {
  project(normal);
  const auto n = static_cast<std::int32_t>(points_.size());
  next_.resize(points_.size());
  previous_.resize(points_.size());
  for (std::int32_t i = 0; i < n; ++i) {
    next_[i] = i + 1 < n ? i + 1 : 0;
    previous_[i] = i > 0 ? i - 1 : n - 1;
  }
  blockers_.clear();
  blocks_.assign(points_.size(), false);
  for (std::int32_t i = 0; i < n; ++i) {
    if (is_convex(i)) continue;
    blocks_[i] = true;
    blockers_.push_back(i);
  }
  tests_left_ = kTestsPerCorner * n + shared_tests_;

  // Advances by two corners after each cut, which makes fewer slivers than cutting along one
  // corner.
  std::int32_t corner = 0;
  std::int32_t refused = 0;
  for (std::int32_t left = n; left > 3;) {
    if (tests_left_ > 0 && refused < left && !is_ear(corner)) {
      corner = next_[corner];
      ++refused;
      continue;
    }
    const std::int32_t after = next_[corner];
    cut(corner);
    // If no tests are left, the corner after the first is always cut, which makes a fan.
    corner = tests_left_ > 0 ? next_[after] : after;
    refused = 0;
    --left;
  }
  triangles_.push_back({previous_[corner], corner, next_[corner]});
  shared_tests_ = std::max<std::int64_t>(0, std::min(shared_tests_, tests_left_));
}

// Coordinates along two axes of the plane, counter-clockwise about the normal.
void PolygonTriangulator::project(const Vector3d& normal) {
  const double length = normal.norm();
  const Vector3d w = length > 0.0 ? Vector3d(normal / length) : Vector3d::UnitZ();
  int smallest = 0;
  w.cwiseAbs().minCoeff(&smallest);
  const Vector3d u = Vector3d::Unit(smallest).cross(w).normalized();
  const Vector3d v = w.cross(u);
  plane_.resize(points_.size());
  std::transform(points_.begin(), points_.end(), plane_.begin(),
                 [&](const Vector3d& p) { return Vector2d(p.dot(u), p.dot(v)); });
}

double PolygonTriangulator::orientation(std::int32_t a, std::int32_t b, std::int32_t c) const {
  const Vector2d& p = plane_[a];
  const Vector2d ab = plane_[b] - p;
  const Vector2d ac = plane_[c] - p;
  return ab.x() * ac.y() - ab.y() * ac.x();
}

bool PolygonTriangulator::is_convex(std::int32_t corner) const {
  const std::size_t at = corner;
  return orientation(previous_[at], corner, next_[at]) > kInLine;
}

bool PolygonTriangulator::is_ear(std::int32_t corner) {
  --tests_left_;
  if (blocks_[corner]) return false;
  const std::int32_t a = previous_[corner];
  const std::int32_t c = next_[corner];
  const auto same_place = [&](std::int32_t i, std::int32_t j) { return plane_[i] == plane_[j]; };
  tests_left_ -= static_cast<std::int64_t>(blockers_.size());
  for (const std::int32_t p : blockers_) {
    if (!blocks_[p] || p == a || p == c) continue;
    // A hole connected by a bridge visits the same position twice, which does not block.
    if (same_place(p, a) || same_place(p, corner) || same_place(p, c)) continue;
    if (orientation(a, corner, p) >= -kInLine && orientation(corner, c, p) >= -kInLine &&
        orientation(c, a, p) >= -kInLine) {
      return false;
    }
  }
  return true;
}

void PolygonTriangulator::cut(std::int32_t corner) {
  const std::size_t at = corner;
  const std::int32_t a = previous_[at];
  const std::int32_t c = next_[at];
  triangles_.push_back({a, corner, c});
  next_[a] = c;
  previous_[c] = a;
  blocks_[at] = false;
  // A cut never makes its neighbours less convex.
  for (const std::int32_t neighbour : {a, c}) {
    if (is_convex(neighbour)) blocks_[neighbour] = false;
  }
}

namespace {

/// Counts the triangles of the polygons after checking that each corner belongs to one of them.
std::int64_t count_triangles(std::int64_t num_vertices, std::span<const std::int32_t> corners,
                             std::span<const std::int32_t> counts) {
  std::int64_t num_corners = 0, num_triangles = 0;
  for (const std::int32_t count : counts) {
    if (count < 0) throw InputError("counts: expected numbers >= 0, got " + std::to_string(count));
    num_corners += count;
    num_triangles += std::max(0, count - 2);
  }
  if (num_corners != static_cast<std::int64_t>(corners.size())) {
    throw InputError("counts: expected " + std::to_string(corners.size()) + " corners, got " +
                     std::to_string(num_corners));
  }
  for (const std::int32_t v : corners) {
    if (v >= 0 && v < num_vertices) continue;
    throw InputError("corners: expected 0 to " + std::to_string(num_vertices - 1) + ", got " +
                     std::to_string(v));
  }
  return num_triangles;
}

}  // namespace

Faces triangulate_polygons(const Eigen::Ref<const Vertices>& vertices,
                           std::span<const std::int32_t> corners,
                           std::span<const std::int32_t> counts) {
  Faces triangles(count_triangles(vertices.rows(), corners, counts), 3);
  PolygonTriangulator triangulator;
  std::vector<Vector3d> places;
  Eigen::Index row = 0;
  std::int32_t first = 0;
  for (const std::int32_t count : counts) {
    places.clear();
    for (const std::int32_t v : corners.subspan(first, count)) {
      places.emplace_back(vertices.row(v).transpose());
    }
    if (count >= 3) {
      for (const auto& [a, b, c] : triangulator.triangulate(places)) {
        triangles.row(row++) << first + a, first + b, first + c;
      }
    }
    first += count;
  }
  return triangles;
}

}  // namespace manip3d
