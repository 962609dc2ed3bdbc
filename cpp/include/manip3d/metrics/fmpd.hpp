#pragma once

#include <cstdint>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct FmpdOptions {
  /// Clip the value at 1, as in chapter 3 of the dissertation, but not in chapter 2.
  bool clip = false;
  int num_threads = 0;  ///< 0: all cores.
};

struct FmpdResult {
  double value = 0.0;  ///< 8 |difference of the two roughnesses|.
  /// Global roughness, modulated as in the paper; the modulation depends on both meshes.
  double roughness_original = 0.0;
  double roughness_simplified = 0.0;  ///< The same for the simplified mesh.
  std::int64_t skipped_faces = 0;     ///< Faces without area in both meshes.
  bool is_non_manifold = false;       ///< Some vertex of either mesh is not manifold.
};

/// Fast mesh perceptual distance [Wang, Torkhani & Montanvert, Computers & Graphics 2012]: the
/// difference of two global roughnesses, which derive from the Laplacian of Gaussian curvature.
///
/// The result has the same bits for any number of threads; across processors it differs by at most
/// 1e-12 relative (libm).
/// @throws InputError  as check_mesh; a mesh without faces or without area.
FmpdResult fmpd(const MeshView& original, const MeshView& simplified,
                const FmpdOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
