#pragma once

#include <cstdint>
#include <optional>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct TextureErrorOptions {
  std::int64_t samples = 0;  ///< 0: the larger of the two numbers of faces.
  std::uint64_t seed = 0;
  double epsilon = 1e-4;  ///< In diagonals: faces this much farther than the closest count as met.
  int num_threads = 0;    ///< 0: all cores.
};

/// Differences of texture coordinates, in their own unit (1 = a whole texture); none where no
/// sample could be compared. Each sample is compared, skipped, or of another material than what it
/// meets; a sample may be both of the latter.
struct TextureError {
  std::optional<double> mean;
  std::optional<double> rms;
  std::optional<double> mse;
  std::optional<double> max;
  std::int64_t samples = 0;              ///< Compared.
  std::int64_t skipped = 0;              ///< A face without texture coordinates, on either side.
  std::int64_t material_mismatches = 0;  ///< No face met has the sample's material.
  double material_mismatch_rate = 0.0;   ///< Share of all samples drawn.
};

/// Deviation of texture coordinates [Hoppe, IEEE Visualization 1999]: area-uniform samples of the
/// original against the interpolated texture coordinates at the closest point of the simplified
/// surface.
///
/// Where several faces are met, within epsilon of the closest distance, the one of the sample's
/// material counts whose texture coordinates are nearest: at a seam both sides are at hand.
/// Materials are the same when their indices are; -1 and a missing table both mean none.
/// The result has the same bits for any number of threads.
/// @throws InputError  what metro refuses with `kArea`; epsilon not finite or < 0.
TextureError texture_error(const MeshView& original, const MeshView& simplified,
                           const TextureErrorOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
