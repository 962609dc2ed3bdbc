#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Triangulates polygons, for all readers: deterministic, without new vertices.
///
/// A polygon of n corners gives n - 2 triangles that keep its orientation:
/// - a quad is cut by the diagonal that flips no triangle relative to the polygon's Newell normal;
///   if both or neither do, by the shorter one; if both are equally long, from its first corner;
/// - a larger polygon is triangulated by ear clipping [Meisters, "Polygons have ears", 1975] in the
///   plane through its Newell normal [Sutherland et al., ACM Computing Surveys 1974]; only corners
///   that are not convex can block an ear.
///
/// If no corner is an ear (in self-intersecting or degenerate polygons), the next corner is cut
/// anyway, so that the loop always ends. Ear clipping takes quadratic time. The work of one object
/// is bounded by 128 tests per corner plus 2^26 tests in total, after which the rest of a polygon
/// becomes a fan: polygons of up to 42 corners are always triangulated completely, and so is a
/// single one of about 4000 corners of which half are not convex.
class PolygonTriangulator {
 public:
  using Triangle = std::array<std::int32_t, 3>;

  /// @param corners  Positions of the n >= 3 corners in order.
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
  /// Corners that were not convex at the start; some may be cut off.
  std::vector<std::int32_t> blockers_;
  std::vector<bool> blocks_;  ///< Whether a corner is not convex and not cut off.
  std::vector<Triangle> triangles_;
  std::int64_t shared_tests_ = std::int64_t{1} << 26;
  std::int64_t tests_left_ = 0;
};

/// Triangulate many polygons; the first `counts[0]` corners belong to the first polygon.
///
/// @param vertices  Positions.
/// @param corners   The vertex of each corner.
/// @return  Triangles of corner numbers, polygon by polygon; polygons of fewer than three corners
///          have none.
/// @throws InputError  a vertex out of range; a negative count; counts that do not add up to the
///                     number of corners.
Faces triangulate_polygons(const Eigen::Ref<const Vertices>& vertices,
                           std::span<const std::int32_t> corners,
                           std::span<const std::int32_t> counts);

}  // namespace manip3d
