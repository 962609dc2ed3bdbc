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
  std::int64_t samples = 0;  ///< How many distances there are.
};

enum class Sampling {
  kVertex,  ///< Every vertex that a face uses: exact and without randomness.
  kArea,    ///< Area-uniform random points.
};

struct MetroOptions {
  Sampling sampling = Sampling::kVertex;
  std::int64_t samples = 0;  ///< `kArea`, per direction; 0: 10 x the original's faces.
  std::uint64_t seed = 0;    ///< `kArea` only.
  int num_threads = 0;       ///< 0: all cores.
};

struct MetroResult {
  Deviation forward;      ///< From the original's samples to the simplified surface.
  Deviation backward;     ///< From the simplified surface's samples to the original.
  double diagonal = 0.0;  ///< Diagonal of the bounding box of the original's used vertices.
};

/// Distances between two surfaces [Cignoni, Rocchini & Scopigno, "Metro: measuring error on
/// simplified surfaces", Computer Graphics Forum 1998]: from samples of each to the closest point
/// of the other.
///
/// The result has the same bits for any number of threads. O(N log F) time for N samples, memory
/// linear in F.
/// @throws InputError  what check_mesh refuses; a mesh without faces; an original whose bounding
///                     box is a point; `kArea`: a surface without area, samples < 0.
MetroResult metro(const MeshView& original, const MeshView& simplified,
                  const MetroOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
