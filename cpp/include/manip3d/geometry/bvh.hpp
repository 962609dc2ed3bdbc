#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// A point on a face of a surface, as the result of a query for the nearest point.
struct SurfacePoint {
  std::int32_t face = -1;
  double distance = 0.0;        ///< From the query, in the mesh's units; infinite without a face.
  Eigen::Vector3d barycentric;  ///< Weights of the face's three corners; they sum to 1.
  Eigen::Vector3d point;
};

/// Bounding volume hierarchy over the triangles of a mesh: exact nearest points, in double.
///
/// A face without area is treated as the segment or point that it is. The answer minimizes the pair
/// (squared distance, face index) over all faces, with squared distances as computed; it depends
/// neither on the shape of the tree nor on the hint. If a query equals a corner bit for bit, the
/// distance is 0. Works at any scale and any distance from the origin. Queries are const and may
/// run in parallel.
///
/// O(F log F) time to build, about 170 bytes per face; the mesh is not needed afterwards.
class TriangleBvh {
 public:
  /// @throws InputError  as check_mesh; a mesh without faces.
  explicit TriangleBvh(const MeshView& mesh, const Progress& progress = {});

  /// Overload for some of the faces, in any order. Where one of these is the nearest of all faces,
  /// answers are those of a tree over all faces.
  /// @throws InputError  as above; no faces.
  TriangleBvh(const MeshView& mesh, std::span<const std::int32_t> faces,
              const Progress& progress = {});

  [[nodiscard]] std::int64_t num_faces() const { return faces_.rows(); }

  /// @param near_face  A face of the tree that may be near, such as the answer to the previous
  ///                   query. It makes coherent queries faster and never changes the answer. -1:
  ///                   none.
  /// @param max_distance  If no face is within this distance, `face` is -1; the search is then
  ///                      faster.
  /// @throws InputError  a query that is not finite, or too far away for its distance to be a
  ///                     double.
  [[nodiscard]] SurfacePoint closest_point(const Eigen::Vector3d& query,
                                           std::int32_t near_face = -1,
                                           double max_distance = HUGE_VAL) const;

  /// The nearest point among the faces that `accept` accepts; `face` is -1 if there is none.
  [[nodiscard]] SurfacePoint closest_point_where(
      const Eigen::Vector3d& query, const std::function<bool(std::int32_t face)>& accept) const;

  /// Whether a ray from `origin` hits a face that `accept` accepts. The boxes are tested in single
  /// precision: a ray that only touches an edge may miss it.
  /// @param direction  Its length does not matter; no component may be 0.
  [[nodiscard]] bool is_hit_where(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                                  const std::function<bool(std::int32_t face)>& accept) const;

  /// Finds all faces within `distance` of the query, sorted by face index.
  void faces_within(const Eigen::Vector3d& query, double distance,
                    std::vector<SurfacePoint>& found) const;

 private:
  // A triangle in its own plane frame: A at the origin, its longest edge AB along u, C at (foot,
  // height). Without area, v is 0, and then y of every point is 0 as well.
  struct Triangle {
    Eigen::Vector3d a, u, v;
    double length, foot, height;
  };
  // Closest point (x, y) of a triangle, in its frame.
  struct Candidate {
    double squared_distance;
    double x, y;
    std::int32_t face, slot;
    [[nodiscard]] bool before(const Candidate& other) const {
      return squared_distance < other.squared_distance ||
             (squared_distance == other.squared_distance && face < other.face);
    }
  };
  // Four children. Boxes contain the boxes of their children with a margin; unused lanes are at
  // infinity.
  struct Node {
    Eigen::Array4f min[3], max[3];
    std::int32_t child[4];  // a node, or ~slot of a triangle
  };
  // A query in the units of the tree, with floats that enclose it.
  struct Query {
    Eigen::Vector3d p;
    Eigen::Array4f low[3], high[3];
  };
  struct Primitive;

  [[nodiscard]] std::array<Eigen::Vector3d, 3> corners_of(std::int32_t face) const;
  static Triangle make_triangle(const Eigen::Vector3d corners[3]);
  [[nodiscard]] bool is_hit(std::int32_t slot, const Eigen::Vector3d& origin,
                            const Eigen::Vector3d& direction) const;
  std::int32_t build_node(std::vector<Primitive>& primitives, std::int64_t begin, std::int64_t end,
                          int depth, const Progress& progress);
  [[nodiscard]] Query make_query(const Eigen::Vector3d& query) const;
  [[nodiscard]] Candidate closest_in(std::int32_t slot, const Eigen::Vector3d& p) const;
  [[nodiscard]] SurfacePoint to_surface_point(const Candidate& candidate,
                                              const Eigen::Vector3d& query) const;
  template <typename Visit>
  void traverse(const Query& query, double& squared_limit, const Visit& visit) const;

  Eigen::Vector3d center_;
  double scale_ = 1.0;  // a power of two: scaling is exact
  Vertices vertices_;   // centred and scaled
  Faces faces_;
  std::vector<Triangle> triangles_;         // by slot: the order of the tree's leaves
  std::vector<std::int32_t> face_of_slot_;  // slot -> face
  std::vector<std::int32_t> slot_of_face_;  // face -> slot; -1: not in the tree
  std::vector<Node> nodes_;
};

/// Answers of closest_points, one row per query.
struct ClosestPoints {
  explicit ClosestPoints(std::int64_t count = 0);  ///< All entries are without a face.

  std::vector<double> distances;
  std::vector<std::int32_t> faces;
  Vertices points;
};

/// The nearest point of `mesh` for each row of `points`.
/// @param max_distance  If no face is within this distance, the face is -1, the distance infinite
///                      and the point NaN.
/// @param num_threads   Number of threads, with the meaning that it has for parallel_chunks.
/// @throws InputError  see TriangleBvh; max_distance negative or NaN.
ClosestPoints closest_points(const MeshView& mesh, const Eigen::Ref<const Vertices>& points,
                             double max_distance, int num_threads = 0,
                             const Progress& progress = {});

}  // namespace manip3d
