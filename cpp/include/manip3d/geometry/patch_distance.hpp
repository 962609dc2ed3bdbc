#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace manip3d {

using Triangle3 = std::array<Eigen::Vector3d, 3>;

/// A triangle of a surface. `error` > 0: it stands for a second surface, from which none of its
/// points is farther away.
struct PatchTriangle {
  Triangle3 corners;
  double error = 0.0;
};

/// Distance of a point from the nearest point of a triangle found; a triangle without area counts
/// as the segment or point that it is. Never below the true distance by more than rounding.
double distance(const Eigen::Vector3d& point, const Triangle3& triangle);

/// Certified distances of triangles from patches of others.
///
/// The distance from a convex set is a convex function: over a polygon it is largest at a corner.
/// A triangle is therefore cut into convex polygons, each proved against one triangle of the patch:
/// first along the patch's own edges, seen along the triangle's normal, then, where that is not
/// enough, in halves. Samples are used to refuse only, never to accept. The object holds scratch
/// memory; it is for one thread.
class PatchDistance {
 public:
  /// An upper bound of the largest distance of a point of `triangle` from the patch (plus the
  /// error of the patch's triangle), at most `limit`; infinity where that cannot be shown.
  ///
  /// Rounding is left to the caller: coordinates near 1 are safe with a margin of 1e-13.
  double bound(const Triangle3& triangle, std::span<const PatchTriangle> patch, double limit);

  /// The triangles of the patch on which the last finite bound rests, each once, ascending.
  [[nodiscard]] const std::vector<std::int32_t>& used() const { return used_; }

 private:
  struct Box {
    Eigen::Array3d min, max;
  };
  /// A convex polygon in the plane of the triangle.
  struct Polygon {
    static constexpr int kCapacity = 16;
    std::array<Eigen::Vector2d, kCapacity> corners;
    int size = 0;
  };
  struct Candidate {
    std::int32_t index;
    double farthest;  ///< Bound of the whole triangle against this one alone.
  };
  struct Frame {
    Eigen::Vector3d origin, u, v;
    [[nodiscard]] Eigen::Vector2d project(const Eigen::Vector3d& p) const {
      return {u.dot(p - origin), v.dot(p - origin)};
    }
    [[nodiscard]] Eigen::Vector3d lift(const Eigen::Vector2d& p) const {
      return origin + p.x() * u + p.y() * v;
    }
  };

  static Box box_of(const Triangle3& triangle);
  static bool cut(const Polygon& polygon, const Eigen::Vector2d& from, const Eigen::Vector2d& to,
                  double orientation, Polygon& inside, Polygon& outside);
  bool push_near(const Triangle3& triangle, std::size_t begin, std::size_t end);
  double bound_within(const Triangle3& triangle, std::size_t begin, std::size_t end, int depth);
  double overlay(const Triangle3& triangle, std::size_t begin);
  void subtract(const Polygon& polygon, const std::array<Eigen::Vector2d, 3>& corners,
                double orientation, const Frame& frame, const PatchTriangle& other, double& worst,
                bool& is_used);
  [[nodiscard]] double farthest(const Polygon& polygon, const Frame& frame,
                                const PatchTriangle& other) const;

  std::span<const PatchTriangle> patch_;
  double limit_ = 0.0;
  std::vector<Box> boxes_;             // of the patch
  std::vector<Candidate> candidates_;  // a stack: each level of the recursion has a range of it
  std::vector<Polygon> rest_, next_;   // of the triangle, not yet proved
  std::vector<std::int32_t> used_;
};

}  // namespace manip3d
