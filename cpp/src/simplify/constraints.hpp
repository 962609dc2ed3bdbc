#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/simplify/qem.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/quadric.hpp"

namespace manip3d {

/// Kind of a vertex in the current mesh (step 3 of section 2.4.5). Collapses around a vertex can
/// change it: a complex vertex that loses its extra sheet is no longer complex.
struct VertexClass {
  bool is_boundary = false;  ///< On an edge with exactly one face.
  /// On the boundary with a number of boundary neighbours other than two.
  bool is_complex = false;
  bool is_seam = false;         ///< On a border of materials, or with several texture coordinates.
  bool is_seam_corner = false;  ///< At the end of a seam, at a branch, or on a boundary.
  bool is_manifold = true;      ///< Its faces form one fan, and its edges have one or two faces.
};

VertexClass classify_vertex(const CollapseMesh& mesh, const Ring& ring, std::int32_t v);

/// Whether the method never moves such a vertex.
bool is_locked(const VertexClass& vertex, const QemOptions& options);

/// The quadrics that a method adds to those of the faces (step 4), by vertex, computed once on the
/// input; empty if it adds none.
std::vector<Quadric> constraint_quadrics(const CollapseMesh& mesh,
                                         const std::vector<VertexClass>& classes,
                                         const QemOptions& options);

}  // namespace manip3d
