#pragma once

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {

/// Weights of the planes through boundaries, through seams and along lines of equal colour; planes
/// of faces have 1.
struct BorderWeights {
  double boundary, seam, color = 0.0;
  /// Whether seams that are closed at one end weigh only as much as the texture is parted at the
  /// other one: for tips that RoundingWeld made, so that other meshes keep their results.
  bool parts_tips = false;
};

/// Computes the quadric of each vertex from the planes around it, and finds open and complex
/// vertices. Each plane goes through its vertex, so b and c are zero at first.
/// @return  Whether some edge may be short enough for RoundingWeld.
bool sum_quadrics(FastMesh& mesh, const BorderWeights& weights);

}  // namespace manip3d::fast_detail
