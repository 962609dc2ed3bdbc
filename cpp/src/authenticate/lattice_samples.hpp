#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "authenticate/canonical_order.hpp"
#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// Points as the integers that a watermark binds, and back.
namespace manip3d {

constexpr std::uint8_t kOffLattice = 0x80;  ///< Mark of a point that no embedder writes.

struct LatticeSamples {
  std::vector<WatermarkSample> samples;
  /// Changes of each point by embedding: LBM, the lowest bits of x, y and z; QIM, the quarter
  /// of its cell that z lies at.
  std::vector<std::uint8_t> marks;
};

/// Points at the origin: how some formats say that nothing came back.
inline bool is_no_return(const WatermarkSample& s) { return (s.x | s.y | s.z) == 0; }

/// The nearest unit of 1 mm.
std::int64_t nearest_unit(double metres);

/// Samples without what embedding replaces, and their slices.
/// @throws InputError  a point is off the grid, and is not to be rounded, or too far away.
void sample_for_embedding(const PointsView& points, const WatermarkOptions& options,
                          const SliceTable& slices, LatticeSamples& found,
                          std::vector<std::uint16_t>& slice_of);

/// Samples a scan at the receiver, whose points carry marks.
void sample_for_verification(const PointsView& points, WatermarkEmbedding embedding,
                             std::uint32_t units_per_m, const SliceTable& slices,
                             LatticeSamples& found, std::vector<std::uint16_t>& slice_of);

/// Coordinates in float64 on a stated grid: whole units from an offset.
struct ExactGrid {
  ExactView coordinates;
  std::uint32_t units_per_m;
  std::array<std::int64_t, 3> offset;
};

enum class ExactUse : std::uint8_t { kEmbed, kRound, kVerify };

/// Samples of LBM, with marks for a verifier.
/// @throws InputError  not for a verifier: a point is off the grid, and is not to be rounded, or
/// too
///                     far from the offset.
void sample_exact(const PointsView& points, const ExactGrid& grid, ExactUse use,
                  const SliceTable& slices, LatticeSamples& found,
                  std::vector<std::uint16_t>& slice_of);

/// Writes the coordinates of all samples of LBM; `marks` hold their bits, in x, y and z alike.
void write_exact(const LatticeSamples& found, const ExactGrid& grid, double* xyz);

/// The mark of a sample that carries `bit`.
std::uint8_t mark_of(const WatermarkSample& sample, std::uint8_t bit, WatermarkEmbedding embedding);

/// Writes the coordinates of all samples, metres; `marks` hold their bits.
void write_samples(const LatticeSamples& found, WatermarkEmbedding embedding,
                   std::uint32_t units_per_m, float* xyz);

/// Sorts the marks, and the rows with them, of identical samples of a tile: they carry their bits
/// in ascending order.
void sort_marks_of_equals(TiledSamples& tiled, std::size_t tile);

}  // namespace manip3d
