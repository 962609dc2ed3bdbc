#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/simplify/qem.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/quadric.hpp"

namespace manip3d {

/// Kind of a vertex in the mesh as it stands (step 3 of section 2.4.5). Collapses around a vertex
/// can change it: a complex vertex whose extra sheet has gone is complex no more.
struct VertexClass {
  bool is_boundary = false;     ///< On an edge with exactly one face.
  bool is_complex = false;      ///< On the boundary with other than two boundary neighbours.
  bool is_seam = false;         ///< Between materials, or with several texture coordinates.
  bool is_seam_corner = false;  ///< Where a seam ends, branches or meets a boundary.
  bool is_manifold = true;      ///< One fan of faces, on edges with one or two faces.
};

VertexClass classify_vertex(const CollapseMesh& mesh, const Ring& ring, std::int32_t v);

/// True when the method never moves such a vertex.
bool is_locked(const VertexClass& vertex, const QemOptions& options);

/// The quadrics that a method adds to those of the faces (step 4), per vertex, computed once on
/// the input; empty when it adds none.
std::vector<Quadric> constraint_quadrics(const CollapseMesh& mesh,
                                         const std::vector<VertexClass>& classes,
                                         const QemOptions& options);

}  // namespace manip3d
