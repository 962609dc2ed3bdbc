#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace manip3d {

using Triangle3 = std::array<Eigen::Vector3d, 3>;

/// A triangle of a surface. If `error` > 0, it represents a second surface: none of its points is
/// farther than this from that surface.
struct PatchTriangle {
  Triangle3 corners;
  double error = 0.0;
};

/// Return the distance of a point from the nearest point that was found on a triangle; a triangle
/// without area is treated as the segment or point that it is. The result is below the true
/// distance by rounding errors at most.
double distance(const Eigen::Vector3d& point, const Triangle3& triangle);

/// Certified upper bounds of the distances of triangles from patches of other triangles.
///
/// The distance from a convex set is a convex function, whose maximum over a polygon is at a
/// corner. A triangle is therefore cut into convex polygons, each of which is proved against one
/// triangle of the patch: first along the patch's own edges, projected along the triangle's normal;
/// then, if that is not enough, into halves. Samples are only used to refuse, never to accept. The
/// object holds scratch memory and must not be shared by threads.
class PatchDistance {
 public:
  /// An upper bound of the largest distance of a point of `triangle` from the patch (plus the error
  /// of the patch's triangle), at most `limit`; infinity if no such bound can be proved.
  ///
  /// The caller must allow for rounding: for coordinates near 1, a margin of 1e-13 is safe.
  double bound(const Triangle3& triangle, std::span<const PatchTriangle> patch, double limit);

  /// The triangles of the patch that the last finite bound depends on, each once, ascending.
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
    double farthest;  ///< Bound of the whole triangle against this triangle alone.
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
  std::vector<Candidate> candidates_;  // a stack; each level of the recursion has a range in it
  std::vector<Polygon> rest_, next_;   // parts of the triangle that are not proved yet
  std::vector<std::int32_t> used_;
};

}  // namespace manip3d
