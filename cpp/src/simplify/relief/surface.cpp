#include "simplify/relief/surface.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "geometry/cell_cut.hpp"
#include "geometry/constants.hpp"
#include "geometry/lanes.hpp"
#include "geometry/wide_vectors.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d::relief_detail {
namespace {

constexpr std::int64_t kRowsPerChunk = 32;

/// The smallest number of pixels, at least `size`, that is a whole number of tiles and one more:
/// neighbouring tiles share their border pixels.
int padded(int size) {
  const int tiles = std::max(1, (size - 2) / Surface::kTile + 1);
  return tiles * Surface::kTile + 1;
}

/// The bits of Cell for a CellCut, whose corners 0 to 3 are a, b, d, c here.
std::uint8_t cell_of(CellCut cut) {
  constexpr std::array<std::uint8_t, 7> kCells = {
      0,     kCutFromBToC | kSecond, kSecond, kCutFromBToC | kFirst, kFirst,
      kFull, kCutFromBToC | kFull};
  return kCells[static_cast<std::size_t>(cut)];
}

/// Divides a buffer into rows of equal size: each call of row() returns the next one.
template <typename Item>
class BufferRows {
 public:
  BufferRows(Item* first, std::size_t size) : next_(first), size_(size) {}
  std::span<Item> row() {
    const std::span<Item> taken(next_, size_);
    next_ += size_;
    return taken;
  }

 private:
  Item* next_;
  std::size_t size_;
};

// The input of cell_of_bits(). Bits 0 to 3: corners a, b, d, c are valid.
constexpr std::uint16_t kTurned = 16;  // the diagonal from b to c is the shorter one
// The two corners are no farther apart than DenseRule::max_edge.
constexpr std::uint16_t kNearAB = 32, kNearDC = 64, kNearAC = 128, kNearBD = 256, kNearAD = 512,
                        kNearBC = 1024;
constexpr std::uint16_t kAllNear = kNearAB | kNearDC | kNearAC | kNearBD | kNearAD | kNearBC;
constexpr unsigned kAllCellBits = 2048;

/// The triangles of a cell (bits of Cell) before steps are looked at.
/// @param bits  sum of the bits above.
std::uint8_t cell_of_bits(unsigned bits) {
  const auto has = [bits](unsigned all) { return (bits & all) == all; };
  std::uint8_t cell = cell_of(cut_cell(bits & 15U, [&](int i, int) {
    return (i == 0) == has(kTurned) ? 1.0F : 0.0F;  // i = 0: the diagonal from a to d
  }));
  const bool turned = (cell & kCutFromBToC) != 0;
  if (!has(turned ? kNearAB | kNearBC | kNearAC : kNearAB | kNearBD | kNearAD)) {
    cell &= static_cast<std::uint8_t>(~kFirst);
  }
  if (!has(turned ? kNearBD | kNearDC | kNearBC : kNearAD | kNearDC | kNearAC)) {
    cell &= static_cast<std::uint8_t>(~kSecond);
  }
  return (cell & kFull) == 0 ? std::uint8_t{0} : cell;
}

const std::array<std::uint8_t, kAllCellBits>& cells_by_bits() {
  static const std::array<std::uint8_t, kAllCellBits> cells = [] {
    std::array<std::uint8_t, kAllCellBits> all{};
    for (unsigned bits = 0; bits < kAllCellBits; ++bits) all[bits] = cell_of_bits(bits);
    return all;
  }();
  return cells;
}

/// The coordinates of a row of points in three arrays, with zeros behind them because loops take
/// four points at a time.
struct CoordinateRow {
  explicit CoordinateRow(BufferRows<float>& rows) : x(rows.row()), y(rows.row()), z(rows.row()) {}
  std::span<float> x, y, z;

  void clear() {
    for (const std::span<float> row : {x, y, z}) std::fill(row.begin(), row.end(), 0.0F);
  }
};

/// For a row of cells: a third of the area of each first and second triangle, and a mask (all bits
/// set or none) that tells whether the cell is cut from b to c. Cell u is entry u + 1; entry 0 and
/// some entries after the last cell stand for cells without triangles.
struct AreaRow {
  explicit AreaRow(BufferRows<float>& rows)
      : first(rows.row()), second(rows.row()), turned(rows.row()) {}
  std::span<float> first, second, turned;

  void clear() {
    for (const std::span<float> row : {first, second, turned}) {
      std::fill(row.begin(), row.end(), 0.0F);
    }
  }
  /// Stores the values of the four cells from cell u on.
  void store(std::ptrdiff_t u, Float4 firsts, Float4 seconds, Int4 turns) const {
    store4(first.data() + u + 1, firsts);
    store4(second.data() + u + 1, seconds);
    std::memcpy(turned.data() + u + 1, &turns, sizeof turns);
  }
};

/// Four neighbouring points of a row.
struct Point4 {
  Point4(const CoordinateRow& row, std::ptrdiff_t u)
      : x(load4(row.x.data() + u)), y(load4(row.y.data() + u)), z(load4(row.z.data() + u)) {}
  Point4(Float4 x4, Float4 y4, Float4 z4) : x(x4), y(y4), z(z4) {}
  Float4 x, y, z;
};

MANIP3D_INLINE Point4 choose4(Int4 condition, const Point4& p, const Point4& q) {
  return {condition ? p.x : q.x, condition ? p.y : q.y, condition ? p.z : q.z};
}

MANIP3D_INLINE Float4 squared_distances(const Point4& p, const Point4& q) {
  const Float4 dx = p.x - q.x, dy = p.y - q.y, dz = p.z - q.z;
  return dx * dx + (dy * dy + dz * dz);
}

/// A third of the areas of four triangles.
MANIP3D_INLINE Float4 thirds(const Point4& p, const Point4& q, const Point4& r) {
  constexpr float kSixth = 1.0F / 6.0F;  // the area is half the cross product; a third of that
  const Float4 ax = q.x - p.x, ay = q.y - p.y, az = q.z - p.z;
  const Float4 bx = r.x - p.x, by = r.y - p.y, bz = r.z - p.z;
  const Float4 nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
  return all_of(kSixth) * sqrt4(nx * nx + (ny * ny + nz * nz));
}

/// Stores the areas of the triangles of four cells; 0 for triangles that are not there.
MANIP3D_INLINE void store_areas(const Point4& a, const Point4& b, const Point4& c, const Point4& d,
                                Int4 cells, const AreaRow& areas, std::ptrdiff_t u) {
  const auto has = [&](std::int32_t bit) -> Int4 { return (cells & bit) != 0; };
  const Int4 turned = has(kCutFromBToC);
  const Float4 one = thirds(a, b, choose4(turned, c, d));
  const Float4 other = thirds(choose4(turned, b, a), d, c);
  areas.store(u, has(kFirst) ? one : all_of(0.0F), has(kSecond) ? other : all_of(0.0F), turned);
}

/// The bits of a cell's corners that are measured, given those of its left side. Masks of 0 and 255
/// are common; any byte but 0 marks a measurement.
MANIP3D_INLINE unsigned valid_corners(const std::uint8_t* above, const std::uint8_t* below) {
  const auto bit = [](std::uint8_t is_valid) { return is_valid != 0 ? 1U : 0U; };
  return bit(above[0]) | bit(above[1]) << 1U | bit(below[1]) << 2U | bit(below[0]) << 3U;
}

constexpr std::uint32_t kFourOnes = 0x01010101U;

/// For each number of four bits: four bytes, each of which is 1 if its bit is set.
constexpr std::array<std::uint32_t, 16> kBytesOfBits = [] {
  std::array<std::uint32_t, 16> bytes{};
  for (std::uint32_t bits = 0; bits < 16; ++bits) {
    for (std::uint32_t i = 0; i < 4; ++i) bytes[bits] |= (bits >> i & 1U) << (8U * i);
  }
  return bytes;
}();

MANIP3D_INLINE std::uint32_t four_bytes(const std::uint8_t* from) {
  std::uint32_t bytes = 0;
  std::memcpy(&bytes, from, sizeof bytes);
  return bytes;
}

MANIP3D_INLINE Float4 minimum(Float4 p, Float4 q) { return p < q ? p : q; }
MANIP3D_INLINE Float4 maximum(Float4 p, Float4 q) { return p > q ? p : q; }

/// (lanes - shift) * scale of four numbers, computed in double precision and rounded once.
MANIP3D_INLINE Float4 normalised(Float4 lanes, Double2 low_shift, Double2 high_shift,
                                 double scale) {
  return rounded((low_doubles(lanes) - low_shift) * scale,
                 (high_doubles(lanes) - high_shift) * scale);
}

/// Builds the cells and samples of a surface, row by row.
class RowBuilder {
 public:
  static constexpr std::ptrdiff_t kPadding = 8;  ///< Entries of a row after its last pixel.
  /// Rows of scratch memory: two CoordinateRows and two AreaRows, three arrays each.
  static constexpr std::ptrdiff_t kFloatRows = 12;

  RowBuilder(const StepRule& steps, double max_edge, double unit, const Eigen::Vector3d& center,
             int num_pixels)
      : steps_(steps),
        max_squared_(static_cast<float>((max_edge / unit) * (max_edge / unit))),
        unit_(unit),
        center_(center),
        num_pixels_(num_pixels) {}

  /// Loads a row of input points, centred and scaled; pixels that are not valid become 0.
  void load(const float* points, const std::uint8_t* valid, CoordinateRow& to) const;
  /// Loads a row of samples as they are.
  void load(const Sample* samples, CoordinateRow& to) const;
  /// Computes the cells between two rows of pixels, and their areas.
  /// @return  the number of their triangles.
  int cut(const CoordinateRow& above, const std::uint8_t* valid_above, const CoordinateRow& below,
          const std::uint8_t* valid_below, std::uint8_t* cells, const AreaRow& areas) const;
  /// Computes the areas of given cells. `cells` has at least one entry after its last cell.
  /// @return  the number of their triangles.
  int measure(const CoordinateRow& above, const CoordinateRow& below, const std::uint8_t* cells,
              AreaRow& areas) const;
  /// Writes the samples of a row of pixels, weighted by the areas of the cells on both sides of it.
  /// @param used  output: 1 for each pixel with a weight above 0.
  /// @return  the number of these.
  int weigh(const CoordinateRow& row, const AreaRow& before, const AreaRow& after, Sample* samples,
            std::uint8_t* used) const;

 private:
  /// One bit per lane: do the depths of the cell's four corners span a step?
  [[nodiscard]] unsigned stepped(const Point4& a, const Point4& b, const Point4& c,
                                 const Point4& d) const;
  /// Leaves out the triangles of a cell that span a step, given the depths of its corners.
  [[nodiscard]] std::uint8_t cut_at_steps(std::uint8_t cell, float za, float zb, float zc,
                                          float zd) const {
    const bool from_b = (cell & kCutFromBToC) != 0;
    if (is_step(za, zb, from_b ? zc : zd)) cell &= static_cast<std::uint8_t>(~kFirst);
    if (is_step(from_b ? zb : za, zd, zc)) cell &= static_cast<std::uint8_t>(~kSecond);
    return (cell & kFull) == 0 ? 0 : cell;
  }
  [[nodiscard]] bool is_step(float z1, float z2, float z3) const {
    const auto [low, high] = std::minmax({z1, z2, z3});
    const auto nearest = static_cast<float>(unit_ * low + center_.z());
    return !(unit_ * double{high - low} <= double{steps_.limit(nearest)});
  }

  StepRule steps_;
  float max_squared_;
  double unit_;
  Eigen::Vector3d center_;
  std::ptrdiff_t num_pixels_;
};

MANIP3D_INLINE void RowBuilder::load(const float* points, const std::uint8_t* valid,
                                     CoordinateRow& to) const {
  const double scale = 1.0 / unit_;
  const double cx = center_.x(), cy = center_.y(), cz = center_.z();
  const Double2 xy = {cx, cy}, zx = {cz, cx}, yz = {cy, cz};
  float *const x = to.x.data(), *const y = to.y.data(), *const z = to.z.data();
  const auto clear = [&](std::ptrdiff_t u) { x[u] = y[u] = z[u] = 0.0F; };
  std::ptrdiff_t u = 0;
  for (; u + 4 <= num_pixels_; u += 4) {
    const std::uint32_t four = four_bytes(valid + u);
    if (four == 0) {
      for (std::ptrdiff_t k = u; k < u + 4; ++k) clear(k);
      continue;
    }
    const float* const p = points + 3 * u;
    const Float4 f = normalised(load4(p), xy, zx, scale);
    const Float4 g = normalised(load4(p + 4), yz, xy, scale);
    const Float4 h = normalised(load4(p + 8), zx, yz, scale);
    const Float4 x12 = __builtin_shufflevector(g, h, 2, 2, 5, 5);
    const Float4 y01 = __builtin_shufflevector(f, g, 1, 1, 4, 4);
    const Float4 y23 = __builtin_shufflevector(g, h, 3, 3, 6, 6);
    const Float4 z01 = __builtin_shufflevector(f, g, 2, 2, 5, 5);
    store4(x + u, __builtin_shufflevector(f, x12, 0, 3, 4, 6));
    store4(y + u, __builtin_shufflevector(y01, y23, 0, 2, 4, 6));
    store4(z + u, __builtin_shufflevector(z01, h, 0, 2, 4, 7));
    if (four == kFourOnes) continue;
    for (std::ptrdiff_t k = u; k < u + 4; ++k) {
      if (valid[k] == 0) clear(k);
    }
  }
  for (; u < num_pixels_; ++u) {
    clear(u);
    if (valid[u] == 0) continue;
    const float* const p = points + 3 * u;
    x[u] = static_cast<float>((p[0] - cx) * scale);
    y[u] = static_cast<float>((p[1] - cy) * scale);
    z[u] = static_cast<float>((p[2] - cz) * scale);
  }
}

inline void RowBuilder::load(const Sample* samples, CoordinateRow& to) const {
  for (std::ptrdiff_t u = 0; u < num_pixels_; ++u) {
    to.x[u] = samples[u].x, to.y[u] = samples[u].y, to.z[u] = samples[u].z;
  }
}

MANIP3D_INLINE unsigned RowBuilder::stepped(const Point4& a, const Point4& b, const Point4& c,
                                            const Point4& d) const {
  const Float4 low = minimum(minimum(a.z, b.z), minimum(c.z, d.z));
  const Float4 height = maximum(maximum(a.z, b.z), maximum(c.z, d.z)) - low;
  const Float4 limit = steps_.limit(affine4(unit_, low, center_.z()));
  const Long2 first_two = unit_ * low_doubles(height) <= low_doubles(limit);
  const Long2 last_two = unit_ * high_doubles(height) <= high_doubles(limit);
  return 15U - (true_lanes(first_two) | true_lanes(last_two) << 2U);
}

MANIP3D_INLINE int RowBuilder::cut(const CoordinateRow& row_above, const std::uint8_t* valid_above,
                                   const CoordinateRow& row_below, const std::uint8_t* valid_below,
                                   std::uint8_t* cells, const AreaRow& area_row) const {
  // Local copies: the compiler must assume that a stored byte changes anything that is reached
  // through a reference, and would load it again after each store.
  const CoordinateRow above = row_above, below = row_below;
  const AreaRow areas = area_row;
  const RowBuilder own = *this;
  const std::array<std::uint8_t, kAllCellBits>& cell_by_bits = cells_by_bits();
  const std::ptrdiff_t size = num_pixels_ - 1;
  const bool has_steps = steps_.has_steps(), has_limit = max_squared_ < kInfinityF;
  int num_faces = 0;
  for (std::ptrdiff_t u = 0; u < size; u += 4) {
    const bool whole = u + 4 <= size;
    std::uint32_t all = 0;
    if (whole) {
      const std::uint32_t b0 = four_bytes(valid_above + u), b1 = four_bytes(valid_above + u + 1);
      const std::uint32_t b2 = four_bytes(valid_below + u), b3 = four_bytes(valid_below + u + 1);
      all = b0 & b1 & b2 & b3;
      if ((b0 | b1 | b2 | b3) == 0) {
        std::fill_n(cells + u, 4, std::uint8_t{0});
        areas.store(u, all_of(0.0F), all_of(0.0F), Int4{});
        continue;
      }
    }
    const Point4 a(above, u), b(above, u + 1), c(below, u), d(below, u + 1);
    const Float4 ad = squared_distances(a, d), bc = squared_distances(b, c);
    const Int4 turned = ~(ad <= bc);  // the diagonal from b to c is the shorter one
    const unsigned steps = has_steps ? own.stepped(a, b, c, d) : 0U;
    Int4 near = Int4{} + kAllNear;
    if (has_limit) {
      const auto where = [&](Float4 squared, std::int32_t bit) {
        return (squared <= own.max_squared_) & bit;
      };
      near = where(squared_distances(a, b), kNearAB) | where(squared_distances(d, c), kNearDC) |
             where(squared_distances(a, c), kNearAC) | where(squared_distances(b, d), kNearBD) |
             where(ad, kNearAD) | where(bc, kNearBC);
    }
    const unsigned turns = true_lanes(turned);
    if (all == kFourOnes && steps == 0 && true_lanes(near == kAllNear) == 15) {
      const std::uint32_t bytes = kFull * kFourOnes | kCutFromBToC * kBytesOfBits[turns];
      std::memcpy(cells + u, &bytes, sizeof bytes);
      num_faces += 8;
      areas.store(u, thirds(a, b, choose4(turned, c, d)), thirds(choose4(turned, b, a), d, c),
                  turned);
    } else {
      Int4 four{};
      for (std::ptrdiff_t i = 0; i < std::min<std::ptrdiff_t>(4, size - u); ++i) {
        const std::ptrdiff_t k = u + i;
        const unsigned valid = valid_corners(valid_above + k, valid_below + k);
        const unsigned bits = valid | (turns >> i & 1U) * kTurned | static_cast<unsigned>(near[i]);
        std::uint8_t cell = cell_by_bits[bits];
        // A full cell that spans no step has none in its triangles either.
        const bool may_have_step = (cell & kFull) != kFull || (steps >> i & 1U) != 0;
        if (has_steps && cell != 0 && may_have_step)
          cell = own.cut_at_steps(cell, a.z[i], b.z[i], c.z[i], d.z[i]);
        cells[k] = cell;
        four[i] = cell;
        num_faces += (cell & 1) + (cell >> 1 & 1);
      }
      store_areas(a, b, c, d, four, areas, u);
    }
  }
  return num_faces;
}

inline int RowBuilder::measure(const CoordinateRow& above, const CoordinateRow& below,
                               const std::uint8_t* cells, AreaRow& areas) const {
  int num_faces = 0;
  for (std::ptrdiff_t u = 0; u + 1 < num_pixels_; u += 4) {
    Int4 four{};
    for (std::ptrdiff_t i = 0; i < std::min<std::ptrdiff_t>(4, num_pixels_ - 1 - u); ++i) {
      four[i] = cells[u + i];
      num_faces += (cells[u + i] & 1) + (cells[u + i] >> 1 & 1);
    }
    store_areas({above, u}, {above, u + 1}, {below, u}, {below, u + 1}, four, areas, u);
  }
  return num_faces;
}

MANIP3D_INLINE int RowBuilder::weigh(const CoordinateRow& coordinates, const AreaRow& row_before,
                                     const AreaRow& row_after, Sample* samples,
                                     std::uint8_t* used) const {
  const CoordinateRow row = coordinates;
  const AreaRow before = row_before, after = row_after;
  const auto weights = [&](std::ptrdiff_t u) {
    // Entry u is the cell on the left, u + 1 that on the right.
    const float *f1 = &before.first[u], *s1 = &before.second[u], *t1 = &before.turned[u];
    const float *f2 = &after.first[u], *s2 = &after.second[u], *t2 = &after.turned[u];
    const auto turned = [](const float* from) {
      Int4 mask;
      std::memcpy(&mask, from, sizeof mask);
      return mask;
    };
    const Float4 none = all_of(0.0F);
    // The pixel is corner d or c of the cells before it, and b or a of those after it.
    Float4 sum = (turned(t1) ? none : load4(f1)) + load4(s1);
    sum += turned(t1 + 1) ? load4(f1 + 1) : none;
    sum = sum + load4(s1 + 1) + load4(f2);
    sum += turned(t2) ? load4(s2) : none;
    sum += load4(f2 + 1);
    return sum + (turned(t2 + 1) ? none : load4(s2 + 1));
  };
  int count = 0;
  for (std::ptrdiff_t u = 0; u < num_pixels_; u += 4) {
    const Float4 weight = weights(u);
    const auto four = transpose({load4(&row.x[u]), load4(&row.y[u]), load4(&row.z[u]), weight});
    const unsigned bits = true_lanes(weight > 0.0F);
    if (u + 4 <= num_pixels_) {
      for (std::size_t i = 0; i < 4; ++i)
        store4(&samples[u + static_cast<std::ptrdiff_t>(i)].x, four[i]);
      std::memcpy(used + u, &kBytesOfBits[bits], sizeof kBytesOfBits[bits]);
      count += std::popcount(bits);
      continue;
    }
    for (std::ptrdiff_t i = 0; i < num_pixels_ - u; ++i) {
      const Float4& one = four[static_cast<std::size_t>(i)];
      samples[u + i] = {one[0], one[1], one[2], one[3]};
      used[u + i] = static_cast<std::uint8_t>(bits >> i & 1U);
      count += used[u + i];
    }
  }
  return count;
}

/// Input and output of build_rows().
struct RowJob {
  const PointGridView& grid;
  const RowBuilder& builder;
  int u0, v0, cols, used_cols, used_rows;
  bool is_alone;  ///< One thread runs all chunks, which share one part of the scratch memory.
  std::span<Sample> samples;
  std::span<std::uint8_t> valid, used, cells;
  std::span<float> row_floats;
  std::span<std::uint8_t> row_cells;
  std::span<std::array<int, 2>> row_counts;
};

/// Builds the rows of pixels of one chunk, and the cells between each row and the next.
MANIP3D_INLINE void build_rows(const RowJob& job, std::int64_t begin, std::int64_t end) {
  const PointGridView& grid = job.grid;
  const auto chunk = static_cast<std::size_t>(begin / kRowsPerChunk);
  const std::size_t width = static_cast<std::size_t>(job.used_cols + RowBuilder::kPadding);
  const std::size_t part = job.is_alone ? 0 : chunk;
  BufferRows<float> rows(job.row_floats.data() + part * width * RowBuilder::kFloatRows, width);
  CoordinateRow above(rows), below(rows);
  AreaRow before(rows), after(rows);
  const auto first_of = [&](std::int64_t v) { return (v + job.v0) * grid.cols + job.u0; };
  for (CoordinateRow* row : {&above, &below}) row->clear();
  for (AreaRow* row : {&before, &after}) row->clear();
  job.builder.load(grid.points + 3 * first_of(begin), grid.valid + first_of(begin), below);
  if (begin > 0) {  // the areas of the cells before the chunk, whose cells another chunk stores
    job.builder.load(grid.points + 3 * first_of(begin - 1), grid.valid + first_of(begin - 1),
                     above);
    job.builder.cut(above, grid.valid + first_of(begin - 1), below, grid.valid + first_of(begin),
                    job.row_cells.data() + part * width, before);
  }
  int num_faces = 0, num_used = 0;
  for (std::int64_t v = begin; v < end; ++v) {
    const std::ptrdiff_t row = v * job.cols;
    const std::uint8_t* const valid = grid.valid + first_of(v);
    std::swap(above, below);
    std::copy_n(valid, job.used_cols, job.valid.data() + row);
    if (v + 1 < job.used_rows) {
      const std::int64_t next = first_of(v + 1);
      job.builder.load(grid.points + 3 * next, grid.valid + next, below);
      num_faces +=
          job.builder.cut(above, valid, below, grid.valid + next, job.cells.data() + row, after);
    } else {
      after.clear();
    }
    num_used +=
        job.builder.weigh(above, before, after, job.samples.data() + row, job.used.data() + row);
    std::fill_n(job.samples.data() + row + job.used_cols, job.cols - job.used_cols, Sample{});
    std::swap(before, after);
  }
  job.row_counts[chunk] = {num_faces, num_used};
}

void build_rows_narrow(const RowJob& job, std::int64_t begin, std::int64_t end) {
  build_rows(job, begin, end);
}

#ifdef MANIP3D_AVX2
MANIP3D_AVX2 void build_rows_wide(const RowJob& job, std::int64_t begin, std::int64_t end) {
  build_rows(job, begin, end);
}
#endif

/// The bounding box of points. Four points are twelve numbers, three vectors of four: their
/// extremes are kept lane by lane.
class RowBox {
 public:
  /// Adds the valid points of a row.
  void add(const float* points, const std::uint8_t* valid, std::int64_t size) {
    constexpr std::uint32_t kAllValid = 0x01010101U;
    std::int64_t u = 0;
    for (; u + 4 <= size; u += 4) {
      std::uint32_t four = 0;
      std::memcpy(&four, valid + u, sizeof four);
      if (four == 0) continue;
      if (four != kAllValid) {
        for (std::int64_t k = u; k < u + 4; ++k) add_one(points + 3 * k, valid[k]);
        continue;
      }
      for (std::size_t i = 0; i < 3; ++i) {
        const Float4 p = load4(points + 3 * u + 4 * static_cast<std::int64_t>(i));
        low4_[i] = p < low4_[i] ? p : low4_[i];
        high4_[i] = p > high4_[i] ? p : high4_[i];
      }
    }
    for (; u < size; ++u) add_one(points + 3 * u, valid[u]);
  }

  [[nodiscard]] Vec3 low() const { return least(low4_, low_); }
  [[nodiscard]] Vec3 high() const {
    Lanes minus = high4_;
    for (Float4& lanes : minus) lanes = -lanes;
    return -least(minus, -high_);
  }

 private:
  using Lanes = std::array<Float4, 3>;

  static Lanes all(float value) { return {all_of(value), all_of(value), all_of(value)}; }

  void add_one(const float* point, std::uint8_t valid) {
    if (valid == 0) return;
    const Eigen::Map<const Vec3> p(point);
    low_ = low_.cwiseMin(p);
    high_ = high_.cwiseMax(p);
  }

  static Vec3 least(const Lanes& lanes, Vec3 low) {
    for (int i = 0; i < 12; ++i) low[i % 3] = std::min(low[i % 3], lanes[i / 4][i % 4]);
    return low;
  }

  Lanes low4_ = all(kInfinityF), high4_ = all(-kInfinityF);
  Vec3 low_ = Vec3::Constant(kInfinityF), high_ = Vec3::Constant(-kInfinityF);
};

}  // namespace

bool Surface::crop(const PointGridView& grid) {
  RowBox box;
  std::int64_t first_u = grid.cols, last_u = -1, first_v = grid.rows, last_v = -1;
  for (std::int64_t v = 0; v < grid.rows; ++v) {
    const std::uint8_t* valid = grid.valid + v * grid.cols;
    const float* point = grid.points + v * grid.cols * 3;
    const auto is_valid = [](std::uint8_t one) { return one != 0; };
    const std::uint8_t* const end = valid + grid.cols;
    const std::int64_t row_first = std::find_if(valid, end, is_valid) - valid;
    if (row_first == grid.cols) continue;
    std::int64_t row_last = grid.cols - 1;
    while (valid[row_last] == 0) --row_last;
    box.add(point + 3 * row_first, valid + row_first, row_last - row_first + 1);
    first_u = std::min(first_u, row_first);
    last_u = std::max(last_u, row_last);
    first_v = std::min(first_v, v);
    last_v = v;
  }
  if (last_v < 0) return false;
  u0_ = static_cast<int>(first_u);
  v0_ = static_cast<int>(first_v);
  used_cols_ = static_cast<int>(last_u - first_u + 1);
  used_rows_ = static_cast<int>(last_v - first_v + 1);
  low_ = box.low().cast<double>();
  high_ = box.high().cast<double>();
  const double diagonal = (high_ - low_).norm();
  unit_ = diagonal > 0.0 ? diagonal : 1.0;
  center_ = 0.5 * low_ + 0.5 * high_;
  return true;
}

bool Surface::is_stretched(const DenseRule& rule) const {
  // Single precision resolves 6e-8 of the diagonal, which is 6e-4 of an edge at this ratio.
  constexpr double kManyDepths = 100.0, kManyEdges = 1e4;
  return (steps_.has_steps() && !(high_.z() <= kManyDepths * low_.z())) ||
         !(unit_ <= kManyEdges * rule.max_edge);
}

void Surface::find_joined(const PointGridView& grid, const DenseRule& rule) {
  joined_.assign(grid.rows * grid.cols, 0);
  const auto joins = [&](std::int64_t p, std::int64_t q) {
    const Eigen::Map<const Vec3> a(grid.points + 3 * p), b(grid.points + 3 * q);
    return grid.valid[p] != 0 && grid.valid[q] != 0 &&
           (a.cast<double>() - b.cast<double>()).norm() <= rule.max_edge &&
           !(steps_.has_steps() && steps_.is_step(std::min(a.z(), b.z()), std::max(a.z(), b.z())));
  };
  for (std::int64_t v = 0; v + 1 < grid.rows; ++v) {
    for (std::int64_t u = 0; u + 1 < grid.cols; ++u) {
      const std::int64_t a = v * grid.cols + u;
      const std::array<std::int64_t, 4> cell = {a, a + 1, a + grid.cols, a + grid.cols + 1};
      for (std::size_t without = 0; without < 4; ++without) {
        const std::int64_t p = cell[(without + 1) % 4], q = cell[(without + 2) % 4],
                           r = cell[(without + 3) % 4];
        if (joins(p, q) && joins(q, r) && joins(r, p)) joined_[p] = joined_[q] = joined_[r] = 1;
      }
    }
  }
}

void Surface::build(const PointGridView& grid, const DenseRule& rule, int num_threads) {
  const auto size = static_cast<std::size_t>(cols_) * rows_;
  samples_.resize(size);
  for (std::vector<std::uint8_t>* bytes : {&valid_, &used_, &cells_}) bytes->assign(size, 0);
  const RowBuilder builder(steps_, rule.max_edge, unit_, center_, used_cols_);
  const bool is_alone = num_threads == 1;
  const std::int64_t chunks = (used_rows_ + kRowsPerChunk - 1) / kRowsPerChunk;
  const std::int64_t parts = is_alone ? 1 : chunks, width = used_cols_ + RowBuilder::kPadding;
  make_room(row_floats_, parts * width * RowBuilder::kFloatRows);
  row_floats_.resize(static_cast<std::size_t>(parts * width * RowBuilder::kFloatRows));
  make_room(row_cells_, parts * width);
  row_cells_.resize(static_cast<std::size_t>(parts * width));
  make_room(row_counts_, chunks);
  row_counts_.resize(static_cast<std::size_t>(chunks));
  const RowJob job{grid,     builder, u0_,   v0_,    cols_,       used_cols_, used_rows_, is_alone,
                   samples_, valid_,  used_, cells_, row_floats_, row_cells_, row_counts_};
  // A function object with a single captured reference is stored without an allocation.
  parallel_chunks(used_rows_, kRowsPerChunk, num_threads,
                  [&job](std::int64_t begin, std::int64_t end) {
#ifdef MANIP3D_AVX2
                    if (has_avx2()) return build_rows_wide(job, begin, end);
#endif
                    build_rows_narrow(job, begin, end);
                  });
  for (const auto [num_faces, num_used] : row_counts_) {
    num_faces_ += num_faces;
    num_used_ += num_used;
  }
  std::fill(samples_.begin() + std::ptrdiff_t{used_rows_} * cols_, samples_.end(), Sample{});
}

void Surface::build_around(const PointGridView& grid, const DenseRule& rule, int u, int v) {
  // The cells at the pixel touch samples one pixel away, whose weights depend on cells that reach
  // one pixel farther.
  constexpr int kReach = 2;
  const int first_u = std::max(u - kReach, 0), last_u = std::min(u + kReach, used_cols_ - 1);
  const int first_v = std::max(v - kReach, 0), last_v = std::min(v + kReach, used_rows_ - 1);
  const int across = last_u - first_u + 1;
  const RowBuilder builder(steps_, rule.max_edge, unit_, center_, across);
  constexpr std::size_t kWidth = 2 * kReach + 1 + RowBuilder::kPadding;
  std::array<float, kWidth * RowBuilder::kFloatRows> floats{};
  BufferRows<float> rows(floats.data(), kWidth);
  CoordinateRow above(rows), below(rows);
  AreaRow before(rows), after(rows);
  std::array<Sample, kWidth> samples;
  std::array<std::uint8_t, kWidth> used{}, cells{};
  const auto first_of = [&](int row) {
    return std::int64_t{row + v0_} * grid.cols + first_u + u0_;
  };
  const auto load = [&](int row, CoordinateRow& to) {
    builder.load(grid.points + 3 * first_of(row), grid.valid + first_of(row), to);
  };
  load(first_v, below);
  for (int row = first_v; row <= last_v; ++row) {
    std::swap(above, below);
    const std::ptrdiff_t to = std::ptrdiff_t{row} * cols_ + first_u;
    if (row < last_v) {
      load(row + 1, below);
      num_faces_ += builder.cut(above, grid.valid + first_of(row), below,
                                grid.valid + first_of(row + 1), cells.data(), after);
      for (int i = 0; i + 1 < across; ++i) {
        num_faces_ -= std::popcount(cells_[to + i] & unsigned{kFull});
        cells_[to + i] = cells[i];
      }
    } else {
      after.clear();
    }
    builder.weigh(above, before, after, samples.data(), used.data());
    std::swap(before, after);
    if (std::abs(row - v) > 1) continue;
    for (int i = std::max(u - 1, 0) - first_u; i <= std::min(u + 1, last_u) - first_u; ++i) {
      samples_[to + i] = samples[i];
      num_used_ += used[i] - used_[to + i];
      used_[to + i] = used[i];
    }
  }
}

/// Computes the weights of the samples from the areas of `cells_`.
void Surface::add_areas() {
  const RowBuilder builder(steps_, 1.0, 1.0, center_, used_cols_);
  const std::int64_t width = used_cols_ + RowBuilder::kPadding;
  make_room(row_floats_, width * RowBuilder::kFloatRows);
  row_floats_.resize(static_cast<std::size_t>(width * RowBuilder::kFloatRows));
  BufferRows<float> rows(row_floats_.data(), static_cast<std::size_t>(width));
  CoordinateRow above(rows), below(rows);
  AreaRow before(rows), after(rows);
  for (CoordinateRow* row : {&above, &below}) row->clear();
  for (AreaRow* row : {&before, &after}) row->clear();
  used_.assign(samples_.size(), 0);
  num_faces_ = num_used_ = 0;
  builder.load(samples_.data(), below);
  for (std::ptrdiff_t v = 0; v < used_rows_; ++v) {
    std::swap(above, below);
    if (v + 1 < used_rows_) {
      builder.load(samples_.data() + (v + 1) * cols_, below);
      num_faces_ += builder.measure(above, below, cells_.data() + v * cols_, after);
    } else {
      after.clear();
    }
    num_used_ +=
        builder.weigh(above, before, after, samples_.data() + v * cols_, used_.data() + v * cols_);
    std::swap(before, after);
  }
}

float Surface::mean_area() const { return has_confidence() ? mean_area_ : mean_weight(); }

float Surface::mean_weight() const {
  double total = 0.0;
  for (const Sample& sample : samples_) total += sample.weight;
  return static_cast<float>(total / static_cast<double>(std::max<std::int64_t>(num_used_, 1)));
}

void Surface::weigh(const PointGridView& grid, std::span<const float> confidence) {
  constexpr float kUnsure = 1e-3F;
  confidence_.clear();
  mean_confidence_ = 1.0F;
  least_sure_ = 0.0F;
  avoids_unsure_ = false;
  if (confidence.empty()) return;
  mean_area_ = mean_weight();
  confidence_.assign(samples_.size(), 0.0F);
  for (int v = 0; v < used_rows_; ++v) {
    const float* from = confidence.data() + (v + v0_) * grid.cols + u0_;
    std::copy(from, from + used_cols_, confidence_.begin() + std::ptrdiff_t{v} * cols_);
  }
  double sum = 0.0;
  for (std::size_t p = 0; p < samples_.size(); ++p) {
    samples_[p].weight *= confidence_[p];
    sum += used_[p] != 0 ? double{confidence_[p]} : 0.0;
  }
  if (sum > 0.0) {
    mean_confidence_ = static_cast<float>(sum / static_cast<double>(num_used_));
    least_sure_ = kUnsure * mean_confidence_;
  }
  find_unsure_tiles();
}

void Surface::find_unsure_tiles() {
  if (!has_confidence()) return;
  const int across = cols_ / kConfidenceTile + 1;
  unsure_tiles_.assign(std::size_t{1} * across * (rows_ / kConfidenceTile + 1), 0);
  for (int v = 0; v < used_rows_; ++v) {
    const float* const row = confidence_.data() + std::ptrdiff_t{v} * cols_;
    std::uint8_t* const unsure =
        unsure_tiles_.data() + std::ptrdiff_t{v / kConfidenceTile} * across;
    for (int u = 0; u < used_cols_; ++u) {
      if (row[u] < 1.0F) unsure[u / kConfidenceTile] = 1;
    }
  }
}

void Surface::assign(const PointGridView& whole, const DenseRule& rule,
                     std::span<const float> confidence, int num_threads) {
  num_faces_ = num_used_ = 0;
  steps_ = StepRule(rule);
  num_valid_ = std::count_if(whole.valid, whole.valid + whole.rows * whole.cols,
                             [](std::uint8_t one) { return one != 0; });
  PointGridView grid = whole;
  if (!crop(grid)) return;
  if (is_stretched(rule)) {
    find_joined(whole, rule);
    grid.valid = joined_.data();
    crop(grid);  // if nothing is joined, the first crop stays, without a valid pixel
  }
  cols_ = padded(used_cols_);
  rows_ = padded(used_rows_);
  build(grid, rule, num_threads);
  weigh(grid, confidence);
}

bool Surface::assign_filled(const Surface& before, const PointGridView& grid, const DenseRule& rule,
                            std::span<const float> confidence,
                            std::span<const std::int32_t> filled) {
  if (before.has_confidence() || before.is_stretched(rule)) return false;
  if (!crop(grid) || low_ != before.low_ || high_ != before.high_) return false;
  *this = before;
  for (const std::int32_t pixel : filled) {
    const auto u = static_cast<int>(pixel % grid.cols) - u0_;
    const auto v = static_cast<int>(pixel / grid.cols) - v0_;
    std::uint8_t& is_valid = valid_[std::ptrdiff_t{v} * cols_ + u];
    if (is_valid == 0) ++num_valid_;
    is_valid = 1;
    build_around(grid, rule, u, v);
  }
  weigh(grid, confidence);
  return true;
}

std::int32_t Surface::pixel_at(std::int64_t input_u, std::int64_t input_v) const {
  const std::int64_t du = input_u - u0_, dv = input_v - v0_;
  if (du < 0 || dv < 0 || du >= cols_ || dv >= rows_) return -1;
  return static_cast<std::int32_t>(dv * cols_ + du);
}

void Surface::uses_of_row(std::int64_t input_v, std::span<std::uint8_t> out) const {
  std::fill(out.begin(), out.end(), std::uint8_t{0});
  const std::int64_t v = input_v - v0_;
  if (v < 0 || v >= used_rows_) return;
  const auto from = used_.begin() + v * cols_;
  std::copy(from, from + used_cols_, out.begin() + u0_);
}

void Surface::depths(std::span<float> out) const {
  const auto size = static_cast<std::ptrdiff_t>(samples_.size());
  std::ptrdiff_t p = 0;
  for (; p + 4 <= size; p += 4) {
    const Sample* const four = samples_.data() + p;
    store4(&out[p],
           affine4(unit_, Float4{four[0].z, four[1].z, four[2].z, four[3].z}, center_.z()));
  }
  for (; p < size; ++p) out[p] = depth(static_cast<std::int32_t>(p));
}

void Surface::dense_triangles(std::vector<std::array<std::int32_t, 3>>& out) const {
  out.clear();
  for (int v = 0; v + 1 < used_rows_; ++v) {
    for (int u = 0; u + 1 < used_cols_; ++u) {
      const std::int32_t a = v * cols_ + u;
      for (const bool second : {false, true}) {
        if ((cells_[a] & (second ? kSecond : kFirst)) == 0) continue;
        const auto corners = cell_triangle(cells_[a], second, a, cols_);
        const auto is_used_pixel = [this](std::int32_t p) { return is_used(p); };
        if (std::ranges::all_of(corners, is_used_pixel)) out.push_back(corners);
      }
    }
  }
}

Vec3 Surface::mean_normal() const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int v = 0; v + 1 < used_rows_; ++v) {
    for (int u = 0; u + 1 < used_cols_; ++u) {
      const std::int32_t a = v * cols_ + u;
      if (cells_[a] == 0 || (cells_[a] & kFull) != kFull) continue;
      const Vec3 across = samples_[a + cols_ + 1].point() - samples_[a].point();
      const Vec3 back = samples_[a + cols_].point() - samples_[a + 1].point();
      sum += across.cross(back).cast<double>();
    }
  }
  return sum.norm() > 0.0 ? Vec3(sum.normalized().cast<float>()) : Vec3(Vec3::UnitZ());
}

Eigen::Vector2f Surface::pixels_along(std::int32_t pixel, const Vec3& move) const {
  const auto difference = [&](std::int32_t step, int at, int end) {
    const bool before = at > 0 && is_used(pixel - step);
    const bool after = at + 1 < end && is_used(pixel + step);
    const Vec3 from = samples_[before ? pixel - step : pixel].point();
    const Vec3 to = samples_[after ? pixel + step : pixel].point();
    return Vec3((to - from) / (before && after ? 2.0F : 1.0F));
  };
  const Vec3 du = difference(1, u(pixel), cols_), dv = difference(cols_, v(pixel), rows_);
  Eigen::Matrix2f gram;
  gram << du.dot(du), du.dot(dv), du.dot(dv), dv.dot(dv);
  const Vec3 scaled = move / static_cast<float>(unit_);
  const Eigen::Vector2f along(du.dot(scaled), dv.dot(scaled));
  const float determinant = gram.determinant();
  if (!(determinant > 0.0F)) return Eigen::Vector2f::Zero();
  return gram.inverse() * along;
}

}  // namespace manip3d::relief_detail
