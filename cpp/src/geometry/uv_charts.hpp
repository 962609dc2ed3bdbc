#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// The parts of a texture that the faces of a mesh show, in groups of faces: charts or materials.
class UvCharts {
 public:
  struct Nearest {
    Eigen::Vector2d uv;
    double distance;  ///< Relative to the diagonal of the group's box; infinite off a group
                      ///< that is a point.
  };

  /// @param group  By face: its group, from 0; -1 leaves a face out, as one without texture
  ///               coordinates must be.
  UvCharts(const MeshView& mesh, std::span<const std::int32_t> group,
           const Progress& progress = {});

  /// The point of a group that is nearest to a texture coordinate; none if it has no faces.
  [[nodiscard]] std::optional<Nearest> nearest(std::int32_t group, const Eigen::Vector2d& uv) const;

 private:
  [[nodiscard]] double unit(std::int32_t group) const;
  [[nodiscard]] Eigen::Vector3d scaled(std::int32_t group, const Eigen::Vector2d& uv) const;

  std::vector<Eigen::AlignedBox2d> box_;  // by group
  std::optional<TriangleBvh> bvh_;        // no value if there are no faces
};

}  // namespace manip3d
