#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <vector>

#include "io/gltf_scene.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/io/scene_file.hpp"

namespace manip3d {

/// Encoding of stored positions: `origin + scale * stored`; scale 0: float32.
struct PositionFrame {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  double scale = 0.0;

  [[nodiscard]] bool is_quantized() const { return scale > 0.0; }
};

/// The frame in which 16-bit integers span the bounding box of all levels. It has one scale for all
/// axes, so that normals need none. The scale is a power of two and the origin a multiple of it, so
/// that the same position becomes the same in all meshes whose scale is equal, as for the borders
/// of tiles.
/// @throws InputError  values are beyond float32.
PositionFrame quantized_frame(const std::vector<const MeshView*>& levels);

struct PrimitiveOptions {
  /// Frame of the stored positions. In a quantised frame, normals and texture coordinates are
  /// integers as well. Joints and morph targets need a frame without quantisation.
  PositionFrame frame = {};
  std::int64_t max_vertices = 0;  ///< Largest number in a primitive; 0: no limit.
  std::size_t num_materials = 0;  ///< Materials of the mesh.
  /// Index in the document of a material for faces with or without texture coordinates; empty: the
  /// index in the mesh.
  std::function<std::int64_t(std::int32_t material, bool has_texcoords)> material_of = {};

  /// @throws InputError  the limit is below the three vertices of a face.
  void check() const;
};

/// Writes the triangles of a mesh (bytes and accessors) into `scene`. Returns the primitives.
/// @throws InputError  see build_gltf; the deformation does not fit the mesh.
nlohmann::ordered_json write_primitives(GltfScene& scene, const SceneTriangles& triangles,
                                        const PrimitiveOptions& options);

}  // namespace manip3d
