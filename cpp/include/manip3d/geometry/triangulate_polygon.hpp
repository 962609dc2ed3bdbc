#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Makes triangles of polygons, for all readers alike: deterministic, never a new vertex.
///
/// A polygon of n corners gives n - 2 triangles that keep its orientation:
/// - a quad is cut by the diagonal that flips no triangle against the polygon's Newell normal;
///   if both or neither do, by the shorter; if both are equally long, from its first corner;
/// - a larger one by ear clipping [Meisters, "Polygons have ears", 1975] in the plane through its
///   Newell normal [Sutherland et al., ACM Computing Surveys 1974], where only corners that are
///   not convex can block an ear.
///
/// Where no corner is an ear (self-intersecting or degenerate polygons) the next corner is cut all
/// the same, so that it always ends. Ear clipping is quadratic; the work of one object is bounded
/// by 128 tests per corner plus 2^26 tests in all, after which the rest of a polygon becomes a fan:
/// polygons of up to 42 corners are always cut fully, and so is a single one of some 4 000 corners
/// of which half are not convex.
class PolygonTriangulator {
 public:
  using Triangle = std::array<std::int32_t, 3>;

  /// @param corners  positions of the n >= 3 corners in order.
  /// @return n - 2 triples of corner numbers, valid until the next call.
  std::span<const Triangle> triangulate(std::span<const Eigen::Vector3d> corners);

 private:
  void cut_quad(const Eigen::Vector3d& normal);
  void clip_ears(const Eigen::Vector3d& normal);
  void project(const Eigen::Vector3d& normal);
  [[nodiscard]] double orientation(std::int32_t a, std::int32_t b, std::int32_t c) const;
  [[nodiscard]] bool is_convex(std::int32_t corner) const;
  bool is_ear(std::int32_t corner);
  void cut(std::int32_t corner);

  std::vector<Eigen::Vector3d> points_;  ///< Corners, scaled to the unit cube.
  std::vector<Eigen::Vector2d> plane_;   ///< Corners in the best-fit plane.
  std::vector<std::int32_t> next_, previous_;
  std::vector<std::int32_t> blockers_;  ///< Corners that were not convex; some may be cut by now.
  std::vector<bool> blocks_;            ///< Not convex and not cut.
  std::vector<Triangle> triangles_;
  std::int64_t shared_tests_ = std::int64_t{1} << 26;
  std::int64_t tests_left_ = 0;
};

/// Makes triangles of many polygons: the first `counts[0]` corners are those of the first polygon.
///
/// @param vertices  positions.
/// @param corners   the vertex of each corner.
/// @return triangles of corner numbers, polygon by polygon; polygons of fewer than three corners
///         have none.
/// @throws InputError  a vertex out of range, a negative count, or counts that are not as many
///                     corners as there are.
Faces triangulate_polygons(const Eigen::Ref<const Vertices>& vertices,
                           std::span<const std::int32_t> corners,
                           std::span<const std::int32_t> counts);

}  // namespace manip3d
