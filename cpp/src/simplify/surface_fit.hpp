#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
#include "simplify/collapse_mesh.hpp"

namespace manip3d {

/// Fits the vertices of a simplified mesh to the surface that it stands for, given as points with
/// areas [after Hoppe et al. 1993, "Mesh optimization", with the connectivity fixed].
class SurfaceFit {
 public:
  /// Takes the centroids of all faces of the mesh.
  explicit SurfaceFit(const CollapseMesh& mesh);

  /// Moves each vertex by the mean distance vector from the surface to the points that are
  /// nearest to its faces, a few times.
  /// @param is_there  whether the piece with this vertex (of the original) still exists.
  /// @param may_move  whether a vertex may move there.
  void run(CollapseMesh& mesh, const std::function<bool(std::int32_t)>& is_there,
           const std::function<bool(std::int32_t, const Eigen::Vector3d&)>& may_move,
           const Progress& progress);

  /// Fits texture coordinates to those of the original at the nearest points; after run().
  /// @param may_change  whether those of a vertex may.
  void fit_texture(CollapseMesh& mesh, const std::function<bool(std::int32_t)>& may_change,
                   const Progress& progress) const;

 private:
  void step(CollapseMesh& mesh,
            const std::function<bool(std::int32_t, const Eigen::Vector3d&)>& may_move,
            const Progress& progress) const;
  void keep(const std::function<bool(std::int32_t)>& is_there);

  Vertices points_;
  std::vector<double> areas_;
  std::vector<std::int64_t> surfaces_;    // of a point: CollapseMesh::surface()
  std::vector<Eigen::Vector2d> texture_;  // of a point
  std::vector<std::int32_t> vertices_;    // one of the face of each point
};

}  // namespace manip3d
