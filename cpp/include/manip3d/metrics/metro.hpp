#pragma once

#include <cstdint>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Statistics of the distances from one surface's samples to the other surface, in the meshes'
/// units.
struct Deviation {
  double mean = 0.0;
  double rms = 0.0;  ///< Root of the mean of the squared distances.
  double max = 0.0;
  std::int64_t samples = 0;  ///< Number of distances.
};

enum class Sampling {
  kVertex,  ///< Every vertex used by a face: exact, without randomness.
  kArea,    ///< Area-uniform random points.
};

struct MetroOptions {
  Sampling sampling = Sampling::kVertex;
  /// For kArea: number per direction; 0: 10 times the number of the original's faces.
  std::int64_t samples = 0;
  std::uint64_t seed = 0;  ///< For kArea.
  int num_threads = 0;     ///< 0: all cores.
};

struct MetroResult {
  Deviation forward;      ///< From the original's samples to the simplified surface.
  Deviation backward;     ///< From the simplified surface's samples to the original.
  double diagonal = 0.0;  ///< Diagonal of the bounding box of the original's used vertices.
};

/// Measure the distances between two surfaces [Cignoni, Rocchini & Scopigno, "Metro: measuring
/// error on simplified surfaces", Computer Graphics Forum 1998]: from samples of each surface to
/// the closest point of the other.
///
/// The result has the same bits for any number of threads. O(N log F) time for N samples, memory
/// linear in F.
/// @throws InputError  as check_mesh; a mesh without faces; an original whose bounding box is a
///                     point; for kArea: a surface without area, samples < 0.
MetroResult metro(const MeshView& original, const MeshView& simplified,
                  const MetroOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
