#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
#include "simplify/collapse_mesh.hpp"

namespace manip3d {

/// Fits the vertices of a simplified mesh to the surface that it stands for, of which each face
/// gives a point or three [after Hoppe et al. 1993, "Mesh optimization", with the connectivity
/// fixed].
class SurfaceFit {
 public:
  /// Moves a vertex by a vector for an area of the original that asks for it, or leaves it.
  using Move = std::function<void(std::int32_t v, const Eigen::Vector3d& by, double area)>;

  using SetTexture = std::function<void(std::int32_t wedge, const Eigen::Vector2d& uv)>;

  /// @param original  the mesh that was simplified; it must outlive this.
  /// @param is_there  whether the piece with this vertex (of the original, in a face with three
  ///                  different corners) still exists.
  SurfaceFit(const MeshView& original, std::function<bool(std::int32_t)> is_there);

  /// Moves each vertex by the mean of the vectors from its faces to the samples that are nearest to
  /// them, weighted by area and by how near to the vertex, a few times.
  void run(CollapseMesh& mesh, const Move& move, const Progress& progress);

  /// Fits texture coordinates to those of the original at the samples of run().
  /// @param chart       of each wedge: a sample is compared with faces of its own chart.
  /// @param may_change  whether those of a vertex may.
  /// @param set         gives a wedge a texture coordinate near to the one that fits.
  void fit_texture(CollapseMesh& mesh, const std::vector<std::int32_t>& chart,
                   const std::function<bool(std::int32_t)>& may_change, const SetTexture& set,
                   const Progress& progress);

 private:
  /// A point of the original and the nearest one of the simplified mesh.
  struct Sample {
    std::int32_t face = -1;  // row of now_.faces; -1: none
    float area = 0.0F;
    double distance = 0.0;
    Eigen::Vector3f direction;  // from the surface to the point, a unit vector
    std::uint32_t source = 0;   // four times the face of the original, and the point on it
    Eigen::Vector3d barycentric;
  };

  void place_samples(const CollapseMesh& mesh, bool has_many);
  void find_nearest(const CollapseMesh& mesh, const Progress& progress);
  void find_nearest_to(const CollapseMesh& mesh, const TriangleBvh& bvh, Sample& sample,
                       std::int32_t& near_face) const;
  void find_textured(const CollapseMesh& mesh, const std::vector<std::int32_t>& chart,
                     const Progress& progress);
  void take_positions(const CollapseMesh& mesh);
  void drop_far_samples();
  void step(CollapseMesh& mesh, const Move& move) const;
  [[nodiscard]] double mean_distance() const;
  [[nodiscard]] Eigen::Matrix3d corners_of(const CollapseMesh& mesh, std::int64_t face) const;
  [[nodiscard]] Eigen::Vector3d point_of(const CollapseMesh& mesh, const Sample& sample) const;
  [[nodiscard]] Eigen::Vector2d texture_of(const Sample& sample) const;

  const MeshView& original_;
  std::function<bool(std::int32_t)> is_there_;
  TriangleMesh now_;                 // the simplified mesh of the last search
  std::vector<std::int32_t> slots_;  // row of now_.faces -> face of the CollapseMesh
  double least_distance_ = 0.0;      // that robust_factor() can tell
  std::vector<Sample> samples_;      // in the order of the original's faces
};

}  // namespace manip3d
