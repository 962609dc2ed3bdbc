#pragma once

#include <cstdint>
#include <vector>

#include "simplify/relief/triangulation.hpp"

namespace manip3d::relief_detail {

/// Some triangles of a mesh, their corners as pixels.
struct FewFaces {
  std::vector<Triangle> corners;
  std::int64_t covered = 0;  ///< Sum of the pixels that each of them covers.
};

/// Choose triangles of a mesh with at most this many vertices in total (one for each fan): always
/// the triangle that covers most pixels per vertex that it adds. Triangles off the surface are not
/// chosen; if all are, the result is the largest one.
FewFaces few_faces(const Surface& surface, const Triangulation& mesh, std::int64_t most_vertices);

/// Twice the area in pixels of all triangles.
std::int64_t doubled_pixels(const Triangulation& mesh);

}  // namespace manip3d::relief_detail
