#pragma once

#include <string>
#include <vector>

#include "io/gltf_deformation.hpp"
#include "io/gltf_materials.hpp"
#include "io/gltf_nodes.hpp"
#include "manip3d/io/mesh_file.hpp"

namespace manip3d {

/// The triangles of instances of meshes, in one table without materials.
struct GltfTriangles {
  TriangleMesh mesh;
  /// Primitives in the order of the vertices, without those that share the vertices of another one.
  std::vector<PlacedPrimitive> owners;
  /// Warnings of normals and texture coordinates that are not finite and left out. Other than those
  /// of read_triangles(), they also hold if the document keeps what a mesh has no place for.
  std::vector<std::string> losses;
};

/// Reads the triangles of instances. Primitives of an instance that share vertices in the file
/// share them in the mesh; instances of a mesh share its texture coordinates. Memory is allocated
/// only within the budget.
/// @param warnings  Receives what was left out of the meshes.
/// @throws FormatError  accessors do not fit, or values are not finite in the scene.
GltfTriangles read_triangles(GltfDocument& document, const std::vector<GltfInstance>& instances,
                             GltfTexcoords texcoords, GltfBudget& budget,
                             std::vector<std::string>& warnings, const Progress& progress);

}  // namespace manip3d
