#include "authenticate/lattice_samples.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <string>
#include <tuple>
#include <utility>

#include "authenticate/watermark_record.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int32_t kReach = 4'000'000;  // units of 1 mm: 4 km
constexpr double kUnits = 1000.0;           // of x, y and z a metre
constexpr double kQuarters = 1600.0;        // quarters of a QIM cell of 2.5 mm a metre
// Units or quarters: float32 tells neighbours apart below 2^23.
constexpr std::int32_t kLimit = 8'000'000;

constexpr double kQuarter = 1.0 / kQuarters;

// 1.5 * 2^52 has the integers in its lowest bits: a sum with it is rounded to the nearest one.
constexpr double kShift = 6755399441055744.0;

// The nearest integer, for less than 2^51.
inline std::int64_t nearest(double value) {
  return std::bit_cast<std::int64_t>(value + kShift) - std::bit_cast<std::int64_t>(kShift);
}

// float32(q / 1000) and float32(q / 1600), by a product: q / n is at least 2^-25 / n of itself away
// from where float32 rounds the other way, or is a float32, and the product is wrong by 2^-52 of
// itself, which is less for any n up to 2^26. Divisions take a third of the time of a frame's
// samples.
inline float on_grid(std::int32_t q, double metres) {
  return static_cast<float>(static_cast<double>(q) * metres);
}

// z in units of 1 mm lies in the cell floor(z / 2.5).
inline std::int32_t cell_of(std::int32_t z) {
  const std::int64_t twice = 2 * std::int64_t{z};
  return static_cast<std::int32_t>((twice - ((twice % 5) + 5) % 5) / 5);
}

inline std::int32_t intensity_of(const PointsView& points, Eigen::Index row) {
  return points.has_intensity() ? std::bit_cast<std::int32_t>(points.intensity[row]) : 0;
}

// The grid in words.
std::string grid_of(std::uint32_t units_per_m) {
  return units_per_m == 1000 ? "1 mm" : "1/" + std::to_string(units_per_m) + " m";
}

template <typename Value>
[[noreturn]] void refuse(const Value* xyz, std::int64_t row, const std::string& grid) {
  const auto text = [&](int axis) { return std::to_string(xyz[3 * row + axis]); };
  throw InputError("points: expected coordinates on a grid of " + grid + ", got (" + text(0) +
                   ", " + text(1) + ", " + text(2) + ") in row " + std::to_string(row) +
                   "; embed 'detached', or round the points onto the grid");
}

// A coordinate in float64 as whole units from the offset.
struct Unit {
  std::int64_t from_offset;
  bool is_on_grid, fits;
};

// Coordinates are the nearest float64 to a point of the grid, or one that a format's scale and
// offset make of it: a few times 2^-15 units away, as far from zero as they may be.
constexpr double kOfGrid = 1.0 / 8192.0;
constexpr std::int64_t kExactReach = std::int64_t{1} << 30;

Unit unit_of(double metres, double units, std::int64_t offset) {
  const double scaled = metres * units;
  if (!(std::abs(scaled) < static_cast<double>(kFarthestUnit))) return {0, false, false};
  const std::int64_t whole = nearest(scaled), from_offset = whole - offset;
  const bool fits = from_offset > -kExactReach && from_offset < kExactReach;
  const bool is_on_grid = std::abs(scaled - static_cast<double>(whole)) <= kOfGrid;
  return {fits ? from_offset : 0, is_on_grid, fits};
}

// Slices of integer samples.
void find_slices(const SliceTable& slices, const LatticeSamples& found,
                 std::vector<std::uint16_t>& slice_of) {
  if (found.samples.empty()) return;
  slices.find(&found.samples[0].x, found.samples.size(), 4, slice_of.data());
}

void sample_bits(const PointsView& points, const SliceTable& slices, LatticeSamples& found,
                 std::vector<std::uint16_t>& slice_of) {
  for (Eigen::Index row = 0; row < points.num_points(); ++row) {
    const auto i = static_cast<std::size_t>(row);
    const float x = points.points(row, 0), y = points.points(row, 1), z = points.points(row, 2);
    found.samples[i] = {std::bit_cast<std::int32_t>(x), std::bit_cast<std::int32_t>(y),
                        std::bit_cast<std::int32_t>(z), intensity_of(points, row)};
    found.marks[i] = 0;
  }
  slices.find(points.points.data(), found.samples.size(), 3, slice_of.data());
}

void make_room(const PointsView& points, LatticeSamples& found,
               std::vector<std::uint16_t>& slice_of) {
  const auto size = static_cast<std::size_t>(points.num_points());
  found.samples.resize(size);
  found.marks.resize(size);
  slice_of.resize(size);
}

// Coordinates of a block of points as whole numbers of units.
class Block {
 public:
  static constexpr Eigen::Index kPoints = 128;

  // The units of x and y, and those of z, a metre; values beyond the limit count as the next one.
  Block(double units, double units_z, std::int32_t limit) : limit_(limit), beyond_(limit + 1) {
    for (std::size_t i = 0; i < kValues; ++i) {
      units_[i] = i % 3 == 2 ? units_z : units;
      metres_[i] = 1.0 / units_[i];
    }
  }

  void read(const PointsView& points, Eigen::Index row) {
    const auto count =
        3 * static_cast<std::size_t>(std::min<Eigen::Index>(kPoints, points.num_points() - row));
    const float* values = points.points.data() + 3 * row;
    for (std::size_t i = 0; i < count; ++i) {  // no branches: four values at a time
      const double scaled = static_cast<double>(values[i]) * units_[i];
      const double low = scaled < beyond_ ? scaled : beyond_;
      const double inside = low > -beyond_ ? low : -beyond_;
      const double whole = (inside + kShift) - kShift;
      const auto written = static_cast<float>(whole * metres_[i]);
      q_[i] = static_cast<std::int32_t>(whole);
      equal_[i] = written == values[i] ? -1 : 0;
      same_[i] = std::bit_cast<std::int32_t>(written) == std::bit_cast<std::int32_t>(values[i]);
    }
  }

  [[nodiscard]] std::int32_t x(std::size_t i) const { return q_[3 * i]; }
  [[nodiscard]] std::int32_t y(std::size_t i) const { return q_[3 * i + 1]; }
  [[nodiscard]] std::int32_t z(std::size_t i) const { return q_[3 * i + 2]; }
  // Whether all coordinates are within the limit; on the grid; on it to the bit: -0 and 0 are the
  // same place, but embedders write no -0.
  [[nodiscard]] bool fits(std::size_t i) const {
    return std::abs(x(i)) < limit_ && std::abs(y(i)) < limit_ && std::abs(z(i)) < limit_;
  }
  [[nodiscard]] bool is_on_grid(std::size_t i) const { return all(equal_, i); }
  [[nodiscard]] bool is_written(std::size_t i) const { return all(same_, i); }

 private:
  static constexpr std::size_t kValues = 3 * kPoints;
  template <typename T>
  using Values = std::array<T, kValues>;

  static bool all(const Values<std::int32_t>& flags, std::size_t i) {
    return (flags[3 * i] & flags[3 * i + 1] & flags[3 * i + 2]) != 0;
  }

  std::int32_t limit_;
  double beyond_;
  Values<double> units_, metres_;
  Values<std::int32_t> q_, equal_, same_;
};

// Calls `use(row, i)` for all rows, `i` being the place in the block that holds the row.
template <typename Use>
void for_each_row(const PointsView& points, Block& block, const Use& use) {
  const Eigen::Index size = points.num_points();
  for (Eigen::Index begin = 0; begin < size; begin += Block::kPoints) {
    block.read(points, begin);
    const Eigen::Index end = std::min(size, begin + Block::kPoints);
    for (Eigen::Index row = begin; row < end; ++row)
      use(row, static_cast<std::size_t>(row - begin));
  }
}

}  // namespace

void sample_for_embedding(const PointsView& points, const WatermarkOptions& options,
                          const SliceTable& slices, LatticeSamples& found,
                          std::vector<std::uint16_t>& slice_of) {
  make_room(points, found, slice_of);
  if (options.embedding == WatermarkEmbedding::kDetached) {
    sample_bits(points, slices, found, slice_of);
    return;
  }
  const bool is_lbm = options.embedding == WatermarkEmbedding::kLbm;
  Block block(options.units_per_m, options.units_per_m, kReach);
  for_each_row(points, block, [&](Eigen::Index row, std::size_t i) {
    if (!block.fits(i) || (!options.round && !block.is_on_grid(i))) {
      const double reach = static_cast<double>(kReach) / options.units_per_m;
      const std::string far = options.units_per_m == 1000 ? "4 km" : std::to_string(reach) + " m";
      refuse(points.points.data(), row, grid_of(options.units_per_m) + ", within " + far);
    }
    WatermarkSample& s = found.samples[static_cast<std::size_t>(row)];
    s.intensity = intensity_of(points, row);
    if (is_lbm) {
      s.x = block.x(i) & ~1;
      s.y = block.y(i) & ~1;
      s.z = block.z(i) & ~1;
    } else {
      s.x = block.x(i);
      s.y = block.y(i);
      s.z = cell_of(block.z(i));
    }
    found.marks[static_cast<std::size_t>(row)] = 0;
  });
  find_slices(slices, found, slice_of);
}

void sample_for_verification(const PointsView& points, WatermarkEmbedding embedding,
                             std::uint32_t units_per_m, const SliceTable& slices,
                             LatticeSamples& found, std::vector<std::uint16_t>& slice_of) {
  make_room(points, found, slice_of);
  if (embedding == WatermarkEmbedding::kDetached) {
    sample_bits(points, slices, found, slice_of);
    return;
  }
  const bool is_lbm = embedding == WatermarkEmbedding::kLbm;
  Block block(units_per_m, is_lbm ? units_per_m : kQuarters, kLimit);
  for_each_row(points, block, [&](Eigen::Index row, std::size_t i) {
    WatermarkSample& s = found.samples[static_cast<std::size_t>(row)];
    s.intensity = intensity_of(points, row);
    const std::int32_t x = block.x(i), y = block.y(i), z = block.z(i);
    std::uint8_t mark;
    if (is_lbm) {
      s.x = x & ~1;
      s.y = y & ~1;
      s.z = z & ~1;
      mark = static_cast<std::uint8_t>((x & 1) | (y & 1) << 1 | (z & 1) << 2);
    } else {
      s.x = x;
      s.y = y;
      s.z = z >> 2;
      mark = static_cast<std::uint8_t>(z & 3);
    }
    const bool exact = block.fits(i) && block.is_written(i);
    found.marks[static_cast<std::size_t>(row)] =
        exact ? mark : static_cast<std::uint8_t>(mark | kOffLattice);
  });
  find_slices(slices, found, slice_of);
}

void sample_exact(const PointsView& points, const ExactGrid& grid, ExactUse use,
                  const SliceTable& slices, LatticeSamples& found,
                  std::vector<std::uint16_t>& slice_of) {
  make_room(points, found, slice_of);
  for (Eigen::Index row = 0; row < points.num_points(); ++row) {
    const auto i = static_cast<std::size_t>(row);
    std::array<std::int32_t, 3> q;
    std::uint8_t mark = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const Unit unit =
          unit_of(grid.coordinates[3 * i + axis], grid.units_per_m, grid.offset[axis]);
      const bool accepted = unit.fits && (unit.is_on_grid || use == ExactUse::kRound);
      if (!accepted && use != ExactUse::kVerify) {
        refuse(grid.coordinates.data(), row,
               grid_of(grid.units_per_m) + ", within 2^30 steps of the origin");
      }
      if (!accepted) mark |= kOffLattice;
      q[axis] = static_cast<std::int32_t>(unit.from_offset);
      if (use == ExactUse::kVerify) mark |= static_cast<std::uint8_t>((q[axis] & 1) << axis);
    }
    found.samples[i] = {q[0] & ~1, q[1] & ~1, q[2] & ~1, intensity_of(points, row)};
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
  if (is_no_return(sample)) return 0;  // it stays at the origin
  return bit != 0 ? 3 : 1;
}

void write_sample(const WatermarkSample& sample, std::uint8_t bit, WatermarkEmbedding embedding,
                  float* xyz, double metres) {
  const bool is_lbm = embedding == WatermarkEmbedding::kLbm;
  const std::int32_t own = is_lbm ? bit : 0;
  xyz[0] = on_grid(sample.x | own, metres);
  xyz[1] = on_grid(sample.y | own, metres);
  xyz[2] = is_lbm ? on_grid(sample.z | own, metres)
                  : on_grid(4 * sample.z + mark_of(sample, bit, embedding), kQuarter);
}

void write_samples(const LatticeSamples& found, WatermarkEmbedding embedding,
                   std::uint32_t units_per_m, float* xyz) {
  const double metres = 1.0 / units_per_m;
  for (std::size_t i = 0; i < found.samples.size(); ++i) {
    write_sample(found.samples[i], found.marks[i], embedding, xyz + 3 * i, metres);
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
