#pragma once

#include <span>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Connectivity of any set of triangles, manifold or not. Faces with a repeated index have no edges
/// and connect nothing. Indices must be in range (check_mesh).
namespace manip3d {

/// Whether two corners of the face are the same vertex.
inline bool is_degenerate(const Eigen::Ref<const Faces>& faces, Eigen::Index face) {
  return faces(face, 0) == faces(face, 1) || faces(face, 1) == faces(face, 2) ||
         faces(face, 2) == faces(face, 0);
}

/// Undirected edges, each once, with the faces that use them.
struct Edges {
  Rows<std::int32_t, 2> vertices;     ///< (E, 2) lower vertex first; rows in increasing order.
  std::vector<std::int32_t> offsets;  ///< (E + 1,) index of each edge's first face in `faces`.
  std::vector<std::int32_t> faces;    ///< Faces by edge, increasing within an edge.

  [[nodiscard]] Eigen::Index size() const { return vertices.rows(); }
  [[nodiscard]] std::span<const std::int32_t> faces_of(Eigen::Index edge) const {
    const std::size_t e = edge;
    return std::span(faces).subspan(offsets[e], offsets[e + 1] - offsets[e]);
  }
  /// Used by exactly one face.
  [[nodiscard]] bool is_boundary(Eigen::Index edge) const { return faces_of(edge).size() == 1; }
  /// Used by more than two faces.
  [[nodiscard]] bool is_non_manifold(Eigen::Index edge) const { return faces_of(edge).size() > 2; }
};

/// Find the edges of a mesh. O(F + sum over vertices of valence log valence) time, O(V + F) memory.
Edges find_edges(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices);

/// Return the (V,) number of boundary neighbours of each vertex: the other ends of its boundary
/// edges.
///
/// 0: an interior (or unreferenced) vertex; 2: an ordinary boundary vertex; else a complex vertex,
/// at which boundaries meet (dissertation section 2.4.3).
Indices count_boundary_neighbors(const Edges& edges, std::int64_t num_vertices);

/// Sets of faces that are connected by shared vertices.
struct Components {
  Indices of_vertex;  ///< (V,) component, in the order of their lowest vertices; -1: in no face.
  std::int32_t count = 0;
};
Components find_components(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices);

/// Number of faces whose three vertices are those of an earlier face, in any orientation.
std::int64_t count_duplicate_faces(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices);

}  // namespace manip3d
