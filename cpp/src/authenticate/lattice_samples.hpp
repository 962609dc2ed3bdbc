#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "authenticate/canonical_order.hpp"
#include "manip3d/geometry/point_cloud.hpp"

/// @file
/// Conversion of points to the integers that a watermark binds, and back.
namespace manip3d {

constexpr std::uint8_t kOffLattice = 0x80;  ///< Mark of a point that an embedder never writes.

struct LatticeSamples {
  std::vector<WatermarkSample> samples;
  /// The bits that embedding writes into each point. LBM: the lowest bits of x, y and z (bits 0 to
  /// 2). QIM: the quarter of its cell in which z lies.
  std::vector<std::uint8_t> marks;
};

/// Is the point at the origin? Some formats write missing returns there.
inline bool is_no_return(const WatermarkSample& s) { return (s.x | s.y | s.z) == 0; }

/// The nearest multiple of 1 mm.
std::int64_t nearest_unit(double metres);

/// Whether the sign of a zero is a part of a sample. -0 equals 0, and conversions between formats
/// change one into the other. Early records bound the sign: such a record is verified with kBound.
enum class ZeroSigns : std::uint8_t { kIgnored, kBound };

/// Makes the samples of points, with the bits cleared that embedding replaces, and their slices.
/// @throws InputError  a point is off the grid and must not be rounded, or is too far away.
void sample_for_embedding(const PointsView& points, const WatermarkOptions& options,
                          const SliceTable& slices, LatticeSamples& found,
                          std::vector<std::uint16_t>& slice_of);

/// Makes the samples and marks of a received scan.
void sample_for_verification(const PointsView& points, WatermarkEmbedding embedding,
                             std::uint32_t units_per_m, const SliceTable& slices,
                             LatticeSamples& found, std::vector<std::uint16_t>& slice_of,
                             ZeroSigns signs = ZeroSigns::kIgnored);

/// Float64 coordinates on a grid: whole units from an offset.
struct ExactGrid {
  ExactView coordinates;
  std::uint32_t units_per_m;
  std::array<std::int64_t, 3> offset;
};

enum class ExactUse : std::uint8_t { kEmbed, kRound, kVerify };

/// Makes the samples of LBM from float64 coordinates; for a verifier also their marks.
/// @throws InputError  not for a verifier: a point is off the grid and must not be rounded, or is
///                     too far from the offset.
void sample_exact(const PointsView& points, const ExactGrid& grid, ExactUse use,
                  const SliceTable& slices, LatticeSamples& found,
                  std::vector<std::uint16_t>& slice_of, ZeroSigns signs = ZeroSigns::kIgnored);

/// Writes the coordinates of all samples of LBM, with the bits in `marks`, the same in x, y and z.
void write_exact(const LatticeSamples& found, const ExactGrid& grid, double* xyz);

/// The mark of a sample whose point carries `bit`.
std::uint8_t mark_of(const WatermarkSample& sample, std::uint8_t bit, WatermarkEmbedding embedding);

/// Writes the coordinates of all samples, metres, with the bits in `marks`.
void write_samples(const LatticeSamples& found, WatermarkEmbedding embedding,
                   std::uint32_t units_per_m, float* xyz);

/// Sorts the marks of identical samples of a tile, together with their rows: identical points carry
/// their bits in ascending order.
void sort_marks_of_equals(TiledSamples& tiled, std::size_t tile);

}  // namespace manip3d
