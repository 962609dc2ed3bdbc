#include "authenticate/lattice_samples.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <string>
#include <tuple>
#include <utility>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr double kReach = 4e6;        // units of 1 mm: 4 km
constexpr double kUnits = 1000.0;     // of x, y and z a metre
constexpr double kQuarters = 1600.0;  // quarters of a QIM cell of 2.5 mm a metre
constexpr double kLimit = 8e6;  // units or quarters: float32 tells neighbours apart below 2^23

// The nearest integer, for less than 2^51: 1.5 * 2^52 has the integers in its lowest bits.
inline std::int64_t nearest(double value) {
  constexpr double kShift = 6755399441055744.0;
  return std::bit_cast<std::int64_t>(value + kShift) - std::bit_cast<std::int64_t>(kShift);
}

inline bool same_bits(float a, float b) {
  return std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}

inline float on_grid(std::int64_t q, double units) {
  return static_cast<float>(static_cast<double>(q) / units);
}

// z in units of 1 mm lies in the cell floor(z / 2.5).
inline std::int32_t cell_of(std::int32_t z) {
  const std::int64_t twice = 2 * std::int64_t{z};
  return static_cast<std::int32_t>((twice - ((twice % 5) + 5) % 5) / 5);
}

inline std::int32_t intensity_of(const PointsView& points, Eigen::Index row) {
  return points.has_intensity() ? std::bit_cast<std::int32_t>(points.intensity[row]) : 0;
}

[[noreturn]] void refuse(const PointsView& points, Eigen::Index row) {
  const auto text = [&](int axis) { return std::to_string(points.points(row, axis)); };
  throw InputError("points: expected coordinates on a grid of 1 mm, within 4 km, got (" + text(0) +
                   ", " + text(1) + ", " + text(2) + ") in row " + std::to_string(row) +
                   "; embed 'detached', or round the points onto the grid");
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

struct Quantised {
  std::int32_t q;
  bool is_exact;
};

inline Quantised quantise(float value, double units) {
  const double scaled = static_cast<double>(value) * units;
  const bool fits = scaled > -kLimit && scaled < kLimit;
  const std::int64_t q = nearest(fits ? scaled : 0.0);
  return {static_cast<std::int32_t>(q), fits && same_bits(on_grid(q, units), value)};
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
  for (Eigen::Index row = 0; row < points.num_points(); ++row) {
    const auto i = static_cast<std::size_t>(row);
    std::array<std::int32_t, 3> q;
    for (int axis = 0; axis < 3; ++axis) {
      const float value = points.points(row, axis);
      const double scaled = static_cast<double>(value) * kUnits;
      if (!(scaled > -kReach && scaled < kReach)) refuse(points, row);
      const std::int64_t units = nearest(scaled);
      // -0 and 0 are the same place.
      if (!options.round && on_grid(units, kUnits) != value) refuse(points, row);
      q[static_cast<std::size_t>(axis)] = static_cast<std::int32_t>(units);
    }
    WatermarkSample& s = found.samples[i];
    s.intensity = intensity_of(points, row);
    if (is_lbm) {
      s.x = q[0] & ~1;
      s.y = q[1] & ~1;
      s.z = q[2] & ~1;
    } else {
      s.x = q[0];
      s.y = q[1];
      s.z = cell_of(q[2]);
    }
    found.marks[i] = 0;
  }
  find_slices(slices, found, slice_of);
}

void sample_for_verification(const PointsView& points, WatermarkEmbedding embedding,
                             const SliceTable& slices, LatticeSamples& found,
                             std::vector<std::uint16_t>& slice_of) {
  make_room(points, found, slice_of);
  if (embedding == WatermarkEmbedding::kDetached) {
    sample_bits(points, slices, found, slice_of);
    return;
  }
  const bool is_lbm = embedding == WatermarkEmbedding::kLbm;
  for (Eigen::Index row = 0; row < points.num_points(); ++row) {
    const auto i = static_cast<std::size_t>(row);
    const Quantised x = quantise(points.points(row, 0), kUnits);
    const Quantised y = quantise(points.points(row, 1), kUnits);
    const Quantised z = quantise(points.points(row, 2), is_lbm ? kUnits : kQuarters);
    WatermarkSample& s = found.samples[i];
    s.intensity = intensity_of(points, row);
    std::uint8_t mark;
    if (is_lbm) {
      s.x = x.q & ~1;
      s.y = y.q & ~1;
      s.z = z.q & ~1;
      mark = static_cast<std::uint8_t>((x.q & 1) | (y.q & 1) << 1 | (z.q & 1) << 2);
    } else {
      s.x = x.q;
      s.y = y.q;
      s.z = z.q >> 2;
      mark = static_cast<std::uint8_t>(z.q & 3);
    }
    const bool exact = x.is_exact && y.is_exact && z.is_exact;
    found.marks[i] = exact ? mark : static_cast<std::uint8_t>(mark | kOffLattice);
  }
  find_slices(slices, found, slice_of);
}

std::int64_t nearest_unit(double metres) { return nearest(metres * kUnits); }

std::uint8_t mark_of(const WatermarkSample& sample, std::uint8_t bit,
                     WatermarkEmbedding embedding) {
  if (embedding == WatermarkEmbedding::kLbm) return bit != 0 ? 7 : 0;
  if (is_no_return(sample)) return 0;  // it stays at the origin
  return bit != 0 ? 3 : 1;
}

void write_sample(const WatermarkSample& sample, std::uint8_t bit, WatermarkEmbedding embedding,
                  float* xyz) {
  if (embedding == WatermarkEmbedding::kLbm) {
    xyz[0] = on_grid(sample.x | bit, kUnits);
    xyz[1] = on_grid(sample.y | bit, kUnits);
    xyz[2] = on_grid(sample.z | bit, kUnits);
    return;
  }
  xyz[0] = on_grid(sample.x, kUnits);
  xyz[1] = on_grid(sample.y, kUnits);
  xyz[2] = on_grid(4 * std::int64_t{sample.z} + mark_of(sample, bit, embedding), kQuarters);
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
