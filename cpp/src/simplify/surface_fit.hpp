#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"
#include "simplify/collapse_mesh.hpp"

namespace manip3d {

/// Fits the vertices of a simplified mesh to the original surface, of which each face has one or
/// three samples [after Hoppe et al. 1993, "Mesh optimization", with fixed connectivity].
class SurfaceFit {
 public:
  /// Moves a vertex by a vector that an area of the original requires, or rejects the move.
  using Move = std::function<void(std::int32_t v, const Eigen::Vector3d& by, double area)>;

  using SetTexture = std::function<void(std::int32_t wedge, const Eigen::Vector2d& uv)>;

  /// @param original  The mesh before simplification; it must outlive this object.
  /// @param is_there  Whether the piece with this vertex still exists. The vertex is one of the
  ///                  original, in a face with three different corners.
  SurfaceFit(const MeshView& original, std::function<bool(std::int32_t)> is_there);

  /// Moves each vertex, a few times, by the mean of the vectors from its faces to their samples,
  /// weighted by area and by barycentric coordinate at the vertex.
  void run(CollapseMesh& mesh, const Move& move, const Progress& progress);

  /// Fits texture coordinates to those of the original at the samples of run().
  /// @param chart       Chart of each wedge; a sample is compared with faces of its own chart.
  /// @param may_change  Whether the texture coordinates of a vertex may change.
  /// @param set         Sets the texture coordinate of a wedge near the fitted one.
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
    std::uint32_t source = 0;   // four times the original face plus the sample's number
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
  double least_distance_ = 0.0;      // argument of robust_factor()
  std::vector<Sample> samples_;      // in the order of the original's faces
};

}  // namespace manip3d
