#pragma once

#include <cstdint>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct ColorErrorOptions {
  std::int64_t samples = 0;  ///< 0: the larger number of faces of the two meshes.
  std::uint64_t seed = 0;
  /// In diagonals: faces up to this much farther than the closest one are also met.
  double epsilon = 1e-4;
  int num_threads = 0;  ///< 0: all cores.
};

/// Differences of colours: of each sample the root mean square of its three channels, in levels
/// (255: black beside white).
struct ColorError {
  double mean = 0.0;
  double rms = 0.0;
  double max = 0.0;
  std::int64_t samples = 0;
};

/// Measure how far the colours of vertices changed on the surface: uniform samples of the original
/// are compared with the interpolated colour at the closest point of the simplified surface. If
/// several faces are met, within epsilon of the closest distance, the nearest colour counts,
/// because both sides of a border between colours are equally near. The result has the same bits
/// for any number of threads.
/// @throws InputError  as metro with kArea; a mesh without colours; epsilon not finite or < 0.
ColorError color_error(const MeshView& original, const MeshView& simplified,
                       const ColorErrorOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
