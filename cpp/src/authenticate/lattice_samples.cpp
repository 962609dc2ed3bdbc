#include "authenticate/lattice_samples.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <string>
#include <tuple>
#include <utility>

#include "authenticate/watermark_record.hpp"
#include "geometry/wide_vectors.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int32_t kReach = 4'000'000;  // units of 1 mm: 4 km
constexpr double kUnits = 1000.0;           // units of x, y and z per metre
constexpr double kQuarters = 1600.0;        // quarters of a QIM cell of 2.5 mm per metre
// Units or quarters: below 2^23, float32 distinguishes neighbours.
constexpr std::int32_t kLimit = 8'000'000;

// Doubles near 1.5 * 2^52 have the integer in their lowest bits: adding this rounds to the nearest
// integer.
constexpr double kShift = 6755399441055744.0;

// The nearest integer; |value| < 2^51.
inline std::int64_t nearest(double value) {
  return std::bit_cast<std::int64_t>(value + kShift) - std::bit_cast<std::int64_t>(kShift);
}

// float32(q / 1000) or float32(q / 1600), computed as a product. This is exact: q / n either is a
// float32 or is at least 2^-25 / n of its value away from the border at which float32 rounds the
// other way, and the product has a relative error of 2^-52, which is less for all n up to 2^26.
// Divisions would take a third of the time of sampling a frame.
inline float on_grid(std::int32_t q, double metres) {
  return static_cast<float>(static_cast<double>(q) * metres);
}

// The QIM cell floor(z / 2.5) of z in units of 1 mm.
inline std::int32_t cell_of(std::int32_t z) {
  const std::int64_t twice = 2 * std::int64_t{z};
  return static_cast<std::int32_t>((twice - ((twice % 5) + 5) % 5) / 5);
}

// The bits of a float. Adding 0 makes 0 of -0 and changes no other number.
inline std::int32_t bits_of(float value, ZeroSigns signs) {
  return std::bit_cast<std::int32_t>(signs == ZeroSigns::kIgnored ? value + 0.0F : value);
}

inline std::int32_t intensity_of(const PointsView& points, Eigen::Index row, ZeroSigns signs) {
  return points.has_intensity() ? bits_of(points.intensity[row], signs) : 0;
}

// The grid as text for messages.
std::string grid_of(std::uint32_t units_per_m) {
  return units_per_m == 1000 ? "1 mm" : "1/" + std::to_string(units_per_m) + " m";
}

// Rounding puts a point onto the grid, but does not bring it within reach.
template <typename Value>
[[noreturn]] void refuse(const Value* xyz, std::int64_t row, const std::string& grid,
                         bool is_in_reach) {
  const auto text = [&](int axis) { return number_text(xyz[3 * row + axis]); };
  throw InputError("points: expected coordinates on a grid of " + grid + ", got (" + text(0) +
                   ", " + text(1) + ", " + text(2) + ") in row " + std::to_string(row) +
                   "; embed 'detached'" +
                   (is_in_reach ? ", or round the points onto the grid" : ""));
}

// A float64 coordinate as a whole number of units from the offset.
struct Unit {
  std::int64_t from_offset;
  bool is_on_grid, fits;
};

// Units: largest distance of a coordinate from the grid. A coordinate is the float64 nearest to a
// point of the grid, or was computed with the scale and offset of a file format, which adds an
// error of a few times 2^-15 units at the largest allowed coordinate.
constexpr double kMaxOffGrid = 1.0 / 8192.0;
// Units from the offset: coordinates that are embedded are below this.
constexpr std::int64_t kExactReach = std::int64_t{1} << 30;

// `fits`: the coordinate is less than `reach` units from the offset.
Unit unit_of(double metres, double units, std::int64_t offset, std::int64_t reach) {
  const double scaled = metres * units;
  if (!(std::abs(scaled) < static_cast<double>(kFarthestUnit))) return {0, false, false};
  const std::int64_t whole = nearest(scaled), from_offset = whole - offset;
  const bool fits = from_offset > -reach && from_offset < reach;
  const bool is_on_grid = std::abs(scaled - static_cast<double>(whole)) <= kMaxOffGrid;
  return {fits ? from_offset : 0, is_on_grid, fits};
}

// Finds the slices of integer samples.
void find_slices(const SliceTable& slices, const LatticeSamples& found,
                 std::vector<std::uint16_t>& slice_of) {
  slices.find(found.samples.data(), found.samples.size(), slice_of.data());
}

void sample_bits(const PointsView& points, const SliceTable& slices, ZeroSigns signs,
                 LatticeSamples& found, std::vector<std::uint16_t>& slice_of) {
  for (Eigen::Index row = 0; row < points.num_points(); ++row) {
    const std::size_t i = row;
    const float x = points.points(row, 0), y = points.points(row, 1), z = points.points(row, 2);
    found.samples[i] = {bits_of(x, signs), bits_of(y, signs), bits_of(z, signs),
                        intensity_of(points, row, signs)};
    found.marks[i] = 0;
  }
  slices.find(points.points.data(), found.samples.size(), slice_of.data());
}

void make_room(const PointsView& points, LatticeSamples& found,
               std::vector<std::uint16_t>& slice_of) {
  const std::size_t size = points.num_points();
  found.samples.resize(size);
  found.marks.resize(size);
  slice_of.resize(size);
}

// Requirements for a coordinate. kInReach: it is within the limit. kOnGrid: it equals the float32
// of a point of the grid, as embedders write it; -0, which they never write, equals 0.
enum class Demand { kInReach, kOnGrid };

constexpr std::size_t kBlockPoints = 128;
constexpr std::size_t kBlockValues = 3 * kBlockPoints;

// Coordinates of a block of points as whole numbers of units; `good` is -1 for those that meet the
// demand.
struct Block {
  std::array<double, kBlockValues> units, metres;  // units per metre, metres per unit
  std::array<std::int32_t, kBlockValues> q, good;
  double limit = 0.0;

  Block(double units_xy, double units_z, std::int32_t most) : limit(most) {
    for (std::size_t i = 0; i < kBlockValues; ++i) {
      units[i] = i % 3 == 2 ? units_z : units_xy;
      metres[i] = 1.0 / units[i];
    }
  }

  [[nodiscard]] bool is_good(std::size_t i) const {
    return (good[3 * i] & good[3 * i + 1] & good[3 * i + 2]) != 0;
  }
};

// Do all values meet the demand? Values beyond the limit are clipped just outside it.
template <Demand kDemand>
MANIP3D_INLINE bool read_values(const float* values, std::size_t count, Block& block) {
  const double beyond = block.limit + 1.0;
  std::int32_t all = -1;
  // no branches, so that several values are computed at a time
  for (std::size_t i = 0; i < count; ++i) {
    const double scaled = static_cast<double>(values[i]) * block.units[i];
    const double low = scaled < beyond ? scaled : beyond;
    const double inside = low > -beyond ? low : -beyond;
    const double whole = (inside + kShift) - kShift;
    const auto written = static_cast<float>(whole * block.metres[i]);
    const auto q = static_cast<std::int32_t>(whole);
    const auto most = static_cast<std::int32_t>(block.limit);
    std::int32_t good = ((q < most) & (q > -most)) ? -1 : 0;
    if constexpr (kDemand == Demand::kOnGrid) good &= written == values[i] ? -1 : 0;
    block.q[i] = q;
    block.good[i] = good;
    all &= good;
  }
  return all != 0;
}

MANIP3D_INLINE void write_values(const std::int32_t* q, const double* metres, std::size_t count,
                                 float* values) {
  for (std::size_t i = 0; i < count; ++i) values[i] = on_grid(q[i], metres[i]);
}

template <Demand kDemand>
bool read_block(const float* values, std::size_t count, Block& block) {
  return read_values<kDemand>(values, count, block);
}

void write_block(const std::int32_t* q, const double* metres, std::size_t count, float* values) {
  write_values(q, metres, count, values);
}

#ifdef MANIP3D_AVX2
template <Demand kDemand>
MANIP3D_AVX2 bool read_block_wide(const float* values, std::size_t count, Block& block) {
  return read_values<kDemand>(values, count, block);
}

MANIP3D_AVX2 void write_block_wide(const std::int32_t* q, const double* metres, std::size_t count,
                                   float* values) {
  write_values(q, metres, count, values);
}
#endif

// Calls `use(begin, end, all)` for blocks of rows, with their coordinates in `block`; `all`: all of
// them meet the demand.
template <Demand kDemand, typename Use>
void for_each_block(const PointsView& points, Block& block, const Use& use) {
  auto* read = &read_block<kDemand>;
#ifdef MANIP3D_AVX2
  if (has_avx2()) read = &read_block_wide<kDemand>;
#endif
  const std::size_t size = points.num_points();
  for (std::size_t begin = 0; begin < size; begin += kBlockPoints) {
    const std::size_t end = std::min(size, begin + kBlockPoints);
    const bool all = read(points.points.data() + 3 * begin, 3 * (end - begin), block);
    use(begin, end, all);
  }
}

// Copies the intensities; without intensities they are 0.
void sample_intensities(const PointsView& points, ZeroSigns signs, LatticeSamples& found) {
  WatermarkSample* const samples = found.samples.data();
  const Eigen::Index size = points.num_points();
  for (Eigen::Index row = 0; row < size; ++row) {
    samples[row].intensity = intensity_of(points, row, signs);
  }
}

[[noreturn]] void refuse_first(const PointsView& points, const Block& block, std::size_t begin,
                               std::size_t end, std::uint32_t units_per_m) {
  std::size_t row = begin;
  while (row + 1 < end && block.is_good(row - begin)) ++row;
  const double reach = static_cast<double>(kReach) / units_per_m;
  const std::string far = units_per_m == 1000 ? "4 km" : number_text(reach) + " m";
  const bool is_in_reach = (points.points.row(static_cast<Eigen::Index>(row)).cast<double>() *
                            static_cast<double>(units_per_m))
                               .cwiseAbs()
                               .maxCoeff() < kReach;
  refuse(points.points.data(), static_cast<std::int64_t>(row),
         grid_of(units_per_m) + ", within " + far, is_in_reach);
}

template <Demand kDemand>
void sample_blocks_for_embedding(const PointsView& points, const WatermarkOptions& options,
                                 LatticeSamples& found) {
  const bool is_lbm = options.embedding == WatermarkEmbedding::kLbm;
  Block block(options.units_per_m, options.units_per_m, kReach);
  WatermarkSample* const samples = found.samples.data();
  for_each_block<kDemand>(points, block, [&](std::size_t begin, std::size_t end, bool all) {
    if (!all) refuse_first(points, block, begin, end, options.units_per_m);
    const std::int32_t* q = block.q.data();
    for (std::size_t row = begin; row < end; ++row, q += 3) {
      const std::int32_t shine = samples[row].intensity;
      samples[row] = is_lbm ? WatermarkSample{q[0] & ~1, q[1] & ~1, q[2] & ~1, shine}
                            : WatermarkSample{q[0], q[1], cell_of(q[2]), shine};
    }
  });
}

}  // namespace

void sample_for_embedding(const PointsView& points, const WatermarkOptions& options,
                          const SliceTable& slices, LatticeSamples& found,
                          std::vector<std::uint16_t>& slice_of) {
  make_room(points, found, slice_of);
  if (options.embedding == WatermarkEmbedding::kDetached) {
    sample_bits(points, slices, ZeroSigns::kIgnored, found, slice_of);
    return;
  }
  sample_intensities(points, ZeroSigns::kIgnored, found);
  std::fill(found.marks.begin(), found.marks.end(), std::uint8_t{0});
  if (options.round) {
    sample_blocks_for_embedding<Demand::kInReach>(points, options, found);
  } else {
    sample_blocks_for_embedding<Demand::kOnGrid>(points, options, found);
  }
  find_slices(slices, found, slice_of);
}

void sample_for_verification(const PointsView& points, WatermarkEmbedding embedding,
                             std::uint32_t units_per_m, const SliceTable& slices,
                             LatticeSamples& found, std::vector<std::uint16_t>& slice_of,
                             ZeroSigns signs) {
  make_room(points, found, slice_of);
  if (embedding == WatermarkEmbedding::kDetached) {
    sample_bits(points, slices, signs, found, slice_of);
    return;
  }
  const bool is_lbm = embedding == WatermarkEmbedding::kLbm;
  sample_intensities(points, signs, found);
  Block block(units_per_m, is_lbm ? units_per_m : kQuarters, kLimit);
  WatermarkSample* const samples = found.samples.data();
  std::uint8_t* const marks = found.marks.data();
  const auto use = [&](std::size_t begin, std::size_t end, bool all) {
    const std::int32_t* q = block.q.data();
    for (std::size_t row = begin; row < end; ++row, q += 3) {
      const std::int32_t x = q[0], y = q[1], z = q[2], shine = samples[row].intensity;
      if (is_lbm) {
        samples[row] = {x & ~1, y & ~1, z & ~1, shine};
        marks[row] = static_cast<std::uint8_t>((x & 1) | (y & 1) << 1 | (z & 1) << 2);
      } else {
        samples[row] = {x, y, z >> 2, shine};
        marks[row] = static_cast<std::uint8_t>(z & 3);
      }
    }
    for (std::size_t row = begin; !all && row < end; ++row) {
      if (!block.is_good(row - begin)) marks[row] |= kOffLattice;
    }
  };
  for_each_block<Demand::kOnGrid>(points, block, use);
  find_slices(slices, found, slice_of);
}

void sample_exact(const PointsView& points, const ExactGrid& grid, ExactUse use,
                  const SliceTable& slices, LatticeSamples& found,
                  std::vector<std::uint16_t>& slice_of, ZeroSigns signs) {
  make_room(points, found, slice_of);
  // A bit of 0 moves a negative odd coordinate by one unit away from the offset.
  const std::int64_t reach = kExactReach + (use == ExactUse::kVerify ? 1 : 0);
  for (Eigen::Index row = 0; row < points.num_points(); ++row) {
    const std::size_t i = row;
    std::array<std::int32_t, 3> q;
    std::uint8_t mark = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const Unit unit =
          unit_of(grid.coordinates[3 * i + axis], grid.units_per_m, grid.offset[axis], reach);
      const bool accepted = unit.fits && (unit.is_on_grid || use == ExactUse::kRound);
      if (!accepted && use != ExactUse::kVerify) {
        refuse(grid.coordinates.data(), row,
               grid_of(grid.units_per_m) + ", within 2^30 steps of the origin", unit.fits);
      }
      if (!accepted) mark |= kOffLattice;
      q[axis] = static_cast<std::int32_t>(unit.from_offset);
      if (use == ExactUse::kVerify) mark |= static_cast<std::uint8_t>((q[axis] & 1) << axis);
    }
    found.samples[i] = {q[0] & ~1, q[1] & ~1, q[2] & ~1, intensity_of(points, row, signs)};
    found.marks[i] = mark;
  }
  find_slices(slices, found, slice_of);
}

void write_exact(const LatticeSamples& found, const ExactGrid& grid, double* xyz) {
  for (std::size_t i = 0; i < found.samples.size(); ++i) {
    const WatermarkSample& s = found.samples[i];
    const std::array<std::int32_t, 3> q = {s.x, s.y, s.z};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::int64_t unit = (q[axis] | found.marks[i]) + grid.offset[axis];
      xyz[3 * i + axis] = static_cast<double>(unit) / grid.units_per_m;
    }
  }
}

std::int64_t nearest_unit(double metres) { return nearest(metres * kUnits); }

std::uint8_t mark_of(const WatermarkSample& sample, std::uint8_t bit,
                     WatermarkEmbedding embedding) {
  if (embedding == WatermarkEmbedding::kLbm) return bit != 0 ? 7 : 0;
  if (is_no_return(sample)) return 0;  // the point stays at the origin
  return bit != 0 ? 3 : 1;
}

void write_samples(const LatticeSamples& found, WatermarkEmbedding embedding,
                   std::uint32_t units_per_m, float* xyz) {
  const bool is_lbm = embedding == WatermarkEmbedding::kLbm;
  const Block block(units_per_m, is_lbm ? units_per_m : kQuarters, 0);
  std::array<std::int32_t, kBlockValues> units;
  auto* write = &write_block;
#ifdef MANIP3D_AVX2
  if (has_avx2()) write = &write_block_wide;
#endif
  const WatermarkSample* const samples = found.samples.data();
  const std::uint8_t* const marks = found.marks.data();
  const std::size_t size = found.samples.size();
  for (std::size_t begin = 0; begin < size; begin += kBlockPoints) {
    const std::size_t end = std::min(size, begin + kBlockPoints);
    std::int32_t* q = units.data();
    for (std::size_t i = begin; i < end; ++i, q += 3) {
      const WatermarkSample& s = samples[i];
      const std::int32_t own = is_lbm ? marks[i] : 0;
      q[0] = s.x | own;
      q[1] = s.y | own;
      q[2] = is_lbm ? s.z | own : 4 * s.z + mark_of(s, marks[i], embedding);
    }
    write(units.data(), block.metres.data(), 3 * (end - begin), xyz + 3 * begin);
  }
}

void sort_marks_of_equals(TiledSamples& tiled, std::size_t tile) {
  const std::size_t end = tiled.begins[tile + 1];
  for (std::size_t begin = tiled.begins[tile]; begin < end;) {
    std::size_t run = begin + 1;
    while (run < end && tiled.samples[run] == tiled.samples[begin]) ++run;
    if (run > begin + 1) {
      std::vector<std::pair<std::uint8_t, std::uint32_t>> equals;
      for (std::size_t i = begin; i < run; ++i) equals.emplace_back(tiled.marks[i], tiled.rows[i]);
      std::sort(equals.begin(), equals.end());
      for (std::size_t i = begin; i < run; ++i) {
        std::tie(tiled.marks[i], tiled.rows[i]) = equals[i - begin];
      }
    }
    begin = run;
  }
}

}  // namespace manip3d
