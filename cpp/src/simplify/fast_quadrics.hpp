#pragma once

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {

/// Weights of the planes through boundaries, through seams and along lines of equal colour; planes
/// of faces have 1.
struct BorderWeights {
  double boundary, seam, color = 0.0;
};

/// Computes the quadric of each vertex from the planes around it, and finds open and complex
/// vertices. Each plane goes through its vertex, so b and c are zero at first.
void sum_quadrics(FastMesh& mesh, const BorderWeights& weights);

}  // namespace manip3d::fast_detail
