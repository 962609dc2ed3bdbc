#pragma once

#include <cstdint>
#include <vector>

#include "simplify/relief_triangulation.hpp"

namespace manip3d::relief_detail {

/// Some triangles of a mesh, their corners as pixels.
struct FewFaces {
  std::vector<Triangle> corners;
  std::int64_t covered = 0;  ///< Sum of the pixels that each of them covers.
};

/// Triangles of a mesh that have at most so many vertices, one for each fan: always the one next
/// that covers most pixels for each vertex that it adds. None lies off the surface unless all do;
/// then it is the largest one.
FewFaces few_faces(const Surface& surface, const Triangulation& mesh, std::int64_t most_vertices);

/// Twice the area in pixels of all triangles.
std::int64_t doubled_pixels(const Triangulation& mesh);

}  // namespace manip3d::relief_detail
