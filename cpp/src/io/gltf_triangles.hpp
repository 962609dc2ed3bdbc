#pragma once

#include <string>
#include <vector>

#include "io/gltf_deformation.hpp"
#include "io/gltf_materials.hpp"
#include "io/gltf_nodes.hpp"
#include "manip3d/io/mesh_file.hpp"

namespace manip3d {

/// The triangles of instances of meshes in one table, without their materials.
struct GltfTriangles {
  TriangleMesh mesh;
  /// Primitives in whose order the vertices are; those that share vertices with one are left out.
  std::vector<PlacedPrimitive> owners;
};

/// Primitives of an instance that share their vertices in the file share them in the mesh;
/// instances of a mesh share its texture coordinates. Nothing is allocated that the budget does
/// not allow.
/// @param warnings  tells what of the meshes is left out.
/// @throws FormatError  accessors that do not fit, values that are not finite in the scene.
GltfTriangles read_triangles(GltfDocument& document, const std::vector<GltfInstance>& instances,
                             GltfTexcoords texcoords, GltfBudget& budget,
                             std::vector<std::string>& warnings, const Progress& progress);

}  // namespace manip3d
