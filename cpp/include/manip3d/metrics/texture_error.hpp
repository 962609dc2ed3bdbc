#pragma once

#include <cstdint>
#include <optional>

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

struct TextureErrorOptions {
  std::int64_t samples = 0;  ///< 0: the larger number of faces of the two meshes.
  std::uint64_t seed = 0;
  /// In diagonals: faces up to this much farther than the closest one are also met.
  double epsilon = 1e-4;
  int num_threads = 0;  ///< 0: all cores.
};

/// Differences of texture coordinates, in their own unit (1 = a whole texture); no value if no
/// sample was compared. Each sample is compared, skipped, or mismatched in material; it may be both
/// of the latter.
struct TextureError {
  std::optional<double> mean;
  std::optional<double> rms;
  std::optional<double> mse;
  std::optional<double> max;
  std::int64_t samples = 0;  ///< Compared samples.
  std::int64_t skipped = 0;  ///< Samples on, or closest to, a face without texture coordinates.
  std::int64_t material_mismatches = 0;  ///< Samples for which no met face has the same material.
  double material_mismatch_rate = 0.0;   ///< Share of all samples drawn.
  /// Share of uniform samples of the textured part of the simplified surface whose texture
  /// coordinates no face of the original with the same material has: they show the background of
  /// an atlas. No value if there are no such samples.
  std::optional<double> outside_charts;
};

/// Measure the deviation of texture coordinates [Hoppe, IEEE Visualization 1999]: uniform samples
/// of the original are compared with the interpolated texture coordinates at the closest point of
/// the simplified surface.
///
/// If several faces are met, within epsilon of the closest distance, the one with the sample's
/// material and the nearest texture coordinates is used, because both sides of a seam are equally
/// near. Materials are equal if their indices are; -1 and a missing table both mean no material.
/// The result has the same bits for any number of threads.
/// @throws InputError  as metro with kArea; epsilon not finite or < 0.
TextureError texture_error(const MeshView& original, const MeshView& simplified,
                           const TextureErrorOptions& options = {}, const Progress& progress = {});

}  // namespace manip3d
