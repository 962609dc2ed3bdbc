#pragma once

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {

/// Weights of the planes through boundaries and through seams; those of faces have 1.
struct BorderWeights {
  double boundary, seam;
};

/// Gives each vertex the quadric of the planes around it, and finds which are open or complex. Each
/// plane goes through the vertex it is added to, so b and c are zero at first.
void sum_quadrics(FastMesh& mesh, const BorderWeights& weights);

}  // namespace manip3d::fast_detail
