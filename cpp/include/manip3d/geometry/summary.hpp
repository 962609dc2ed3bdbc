#pragma once

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// Counts that depend on which vertices are considered equal. Degenerate faces (with a repeated
/// index) are excluded from all other counts.
struct TopologyCounts {
  std::int64_t vertices = 0;
  std::int64_t edges = 0;
  std::int64_t boundary_edges = 0;      ///< Used by exactly one face.
  std::int64_t non_manifold_edges = 0;  ///< Used by more than two faces.
  /// On a boundary, but not with exactly two boundary neighbours.
  std::int64_t complex_vertices = 0;
  std::int64_t degenerate_faces = 0;  ///< With a repeated index.
  std::int64_t duplicate_faces = 0;   ///< Same three vertices as an earlier face.
  std::int64_t components = 0;        ///< Groups of faces connected by shared vertices.
};

/// Parts of a mesh, counted as stored and after welding, in which vertices at bit-identical
/// positions are merged and vertices in no face are dropped.
struct MeshSummary {
  TopologyCounts stored;
  TopologyCounts welded;
  std::int64_t faces = 0;
  std::int64_t texcoords = 0;              ///< Rows of the table of texture coordinates.
  std::int64_t unreferenced_vertices = 0;  ///< In no face.
  std::int64_t zero_area_faces = 0;  ///< Not degenerate, and of area zero in double precision.
  std::int64_t materials_used = 0;
  std::int64_t faces_without_texcoords = 0;  ///< At least one corner has no texture coordinate.
  std::int64_t multi_uv_vertices = 0;        ///< Welded vertices with several distinct UV values.
  bool closed = false;                       ///< It has edges, and no boundary edge after welding.
  bool has_normals = false;
  bool has_colors = false;
  BoundingBox bounding_box;
};

/// Count the parts of a mesh. O(V log V + F) time, O(V + F) memory.
/// @throws InputError  as check_mesh.
MeshSummary summarize(const MeshView& mesh);

}  // namespace manip3d
