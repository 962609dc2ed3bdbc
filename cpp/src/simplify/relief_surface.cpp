#include "simplify/relief_surface.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "geometry/cell_cut.hpp"
#include "geometry/constants.hpp"
#include "geometry/lanes.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d::relief_detail {
namespace {

constexpr std::int64_t kRowsPerChunk = 16;

int padded(int size) {
  const int tiles = std::max(1, (size - 2) / Surface::kTile + 1);
  return tiles * Surface::kTile + 1;
}

std::uint8_t cell_of(CellCut cut) {  // corners 0 to 3 are a, b, d, c
  constexpr std::array<std::uint8_t, 7> kCells = {
      0,     kCutFromBToC | kSecond, kSecond, kCutFromBToC | kFirst, kFirst,
      kFull, kCutFromBToC | kFull};
  return kCells[static_cast<std::size_t>(cut)];
}

/// The triangles of a cell of two by two cells, as far as theirs cover them.
/// @param parts   at a, b, c and d.
/// @param turned  a whole one is cut from b to c.
std::uint8_t cell_of_four(const std::array<std::uint8_t, 4>& parts, bool turned) {
  const auto is_whole = [&](int i) { return (parts[i] & kFull) == kFull; };
  if (is_whole(0) && is_whole(1) && is_whole(2) && is_whole(3)) {
    return turned ? std::uint8_t{kCutFromBToC | kFull} : std::uint8_t{kFull};
  }
  // Half of the parts that the cut goes through is enough.
  const auto has = [&](int i, std::uint8_t half) { return is_whole(i) || parts[i] == half; };
  if (is_whole(1) && has(0, kFirst) && has(3, kFirst)) return kFirst;
  if (is_whole(2) && has(0, kSecond) && has(3, kSecond)) return kSecond;
  constexpr std::uint8_t kABC = kCutFromBToC | kFirst, kBDC = kCutFromBToC | kSecond;
  if (is_whole(0) && has(1, kABC) && has(2, kABC)) return kABC;
  if (is_whole(3) && has(1, kBDC) && has(2, kBDC)) return kBDC;
  return 0;
}

/// Hands out the rows of a buffer, one after the other.
template <typename Item>
class Rooms {
 public:
  Rooms(Item* first, std::size_t size) : next_(first), size_(size) {}
  std::span<Item> row() {
    const std::span<Item> taken(next_, size_);
    next_ += size_;
    return taken;
  }

 private:
  Item* next_;
  std::size_t size_;
};

/// A row of samples, coordinate by coordinate: loops over it take several pixels at a time.
struct CoordinateRow {
  explicit CoordinateRow(Rooms<float>& rooms) : x(rooms.row()), y(rooms.row()), z(rooms.row()) {}
  std::span<float> x, y, z;
  void assign(std::span<const Sample> row) {
    for (std::size_t u = 0; u < row.size(); ++u) {
      x[u] = row[u].x, y[u] = row[u].y, z[u] = row[u].z;
    }
  }
};

/// Squared distances of the pixels of two rows, from the given first ones on.
void squared_distances(const CoordinateRow& row, int first, const CoordinateRow& other,
                       int other_first, std::span<float> out) {
  const float *x = row.x.data() + first, *y = row.y.data() + first, *z = row.z.data() + first;
  const float *x2 = other.x.data() + other_first, *y2 = other.y.data() + other_first,
              *z2 = other.z.data() + other_first;
  float* const to = out.data();
  const auto size = static_cast<std::ptrdiff_t>(out.size()) - std::max(first, other_first);
  for (std::ptrdiff_t u = 0; u < size; ++u) {
    const float dx = x[u] - x2[u], dy = y[u] - y2[u], dz = z[u] - z2[u];
    to[u] = dx * dx + (dy * dy + dz * dz);
  }
}

// What decides on a cell, as bits; bits 0 to 3: are a, b, d, c valid?
constexpr std::uint16_t kTurned = 16;  // the diagonal from b to c is the shorter one
// The ends of the side are near enough.
constexpr std::uint16_t kNearAB = 32, kNearDC = 64, kNearAC = 128, kNearBD = 256, kNearAD = 512,
                        kNearBC = 1024;
constexpr std::uint16_t kAllNear = kNearAB | kNearDC | kNearAC | kNearBD | kNearAD | kNearBC;
constexpr unsigned kAllCellBits = 2048;

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

/// Rows of cells in turn, with the lengths of their sides.
class CellRows {
 public:
  static constexpr std::int64_t kFloatRows = 11;

  CellRows(Rooms<float> rooms, std::span<std::uint16_t> bits, float max_squared)
      : max_squared_(max_squared),
        above_(rooms),
        below_(rooms),
        ab_(rooms.row()),
        dc_(rooms.row()),
        ac_(rooms.row()),
        ad_(rooms.row()),
        bc_(rooms.row()),
        bits_(bits) {}

  void start(std::span<const Sample> row) { below_.assign(row); }
  /// The z of the two rows of pixels around the cells.
  [[nodiscard]] std::span<const float> z_above() const { return above_.z; }
  [[nodiscard]] std::span<const float> z_below() const { return below_.z; }

  /// The bits of the cells between the row given last and the next one.
  std::span<const std::uint16_t> next(std::span<const Sample> row) {
    std::swap(above_, below_);
    below_.assign(row);
    squared_distances(above_, 0, below_, 1, ad_);
    squared_distances(above_, 1, below_, 0, bc_);
    const auto size = static_cast<std::ptrdiff_t>(row.size()) - 1;
    std::uint16_t* const bits = bits_.data();
    const float *ad = ad_.data(), *bc = bc_.data();
    const auto where = [](bool condition, std::uint16_t bit) {
      return static_cast<std::uint16_t>(condition ? bit : 0);
    };
    if (!(max_squared_ < kInfinityF)) {
      for (std::ptrdiff_t u = 0; u < size; ++u) {
        bits[u] = static_cast<std::uint16_t>(kAllNear | where(!(ad[u] <= bc[u]), kTurned));
      }
      return bits_;
    }
    squared_distances(above_, 0, above_, 1, ab_);
    squared_distances(below_, 0, below_, 1, dc_);
    squared_distances(above_, 0, below_, 0, ac_);
    const float *ab = ab_.data(), *dc = dc_.data(), *ac = ac_.data();
    const float most = max_squared_;
    for (std::ptrdiff_t u = 0; u < size; ++u) {
      bits[u] = static_cast<std::uint16_t>(
          where(!(ad[u] <= bc[u]), kTurned) | where(ab[u] <= most, kNearAB) |
          where(dc[u] <= most, kNearDC) | where(ac[u] <= most, kNearAC) |
          where(ac[u + 1] <= most, kNearBD) | where(ad[u] <= most, kNearAD) |
          where(bc[u] <= most, kNearBC));
    }
    return bits_;
  }

 private:
  float max_squared_;
  CoordinateRow above_, below_;
  std::span<float> ab_, dc_, ac_, ad_, bc_;
  std::span<std::uint16_t> bits_;
};

/// A third of the areas of the triangles of a row of cells. Cell u is entry u + 1, and there is one
/// without triangles before them and four after them: cells are looked at four at a time.
struct AreaRow {
  AreaRow(Rooms<float>& areas, std::span<std::int32_t> all)
      : first(areas.row()), second(areas.row()), cells(all) {}
  std::span<float> first, second;
  std::span<std::int32_t> cells;  ///< One for each cell of the row.

  void clear() {
    for (const std::span<float> areas : {first, second})
      std::fill(areas.begin(), areas.end(), 0.0F);
    std::fill(cells.begin(), cells.end(), 0);
  }
  void assign(const CoordinateRow& above, const CoordinateRow& below,
              std::span<const std::uint8_t> row);
};

/// Four neighbouring points of a row.
struct Point4 {
  Point4(const CoordinateRow& row, std::ptrdiff_t u)
      : x(load4(&row.x[u])), y(load4(&row.y[u])), z(load4(&row.z[u])) {}
  Point4(Float4 x4, Float4 y4, Float4 z4) : x(x4), y(y4), z(z4) {}
  Float4 x, y, z;
};

Point4 choose4(Int4 condition, const Point4& p, const Point4& q) {
  return {condition ? p.x : q.x, condition ? p.y : q.y, condition ? p.z : q.z};
}

/// A third of the areas of four triangles.
Float4 thirds(const Point4& p, const Point4& q, const Point4& r) {
  constexpr float kSixth = 1.0F / 6.0F;  // half a cross product for each of three corners
  const Float4 ax = q.x - p.x, ay = q.y - p.y, az = q.z - p.z;
  const Float4 bx = r.x - p.x, by = r.y - p.y, bz = r.z - p.z;
  const Float4 nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
  return all_of(kSixth) * sqrt4(nx * nx + (ny * ny + nz * nz));
}

void AreaRow::assign(const CoordinateRow& above, const CoordinateRow& below,
                     std::span<const std::uint8_t> row) {
  std::copy(row.begin(), row.end(), cells.begin() + 1);
  const auto size = static_cast<std::ptrdiff_t>(row.size());
  for (std::ptrdiff_t u = 0; u < size; u += 4) {
    const Int4 cell = load4(&cells[u + 1]);
    const auto has = [&cell](std::int32_t bit) -> Int4 { return (cell & bit) != 0; };
    const Int4 turned = has(kCutFromBToC);
    const Point4 a(above, u), b(above, u + 1), c(below, u), d(below, u + 1);
    const Float4 one = thirds(a, b, choose4(turned, c, d));
    const Float4 other = thirds(choose4(turned, b, a), d, c);
    store4(&first[u + 1], has(kFirst) ? one : all_of(0.0F));
    store4(&second[u + 1], has(kSecond) ? other : all_of(0.0F));
  }
}

/// What the pixels between two rows of cells get.
void add_corners(const AreaRow& before, const AreaRow& after, std::span<float> out) {
  // Entry u is the cell on the left, u + 1 that on the right.
  const float *f1 = before.first.data(), *s1 = before.second.data();
  const float *f2 = after.first.data(), *s2 = after.second.data();
  const std::int32_t *cell1 = before.cells.data(), *cell2 = after.cells.data();
  float* const to = out.data();
  const auto size = static_cast<std::ptrdiff_t>(out.size());
  for (std::ptrdiff_t u = 0; u < size; ++u) {
    const float one1 = f1[u], two1 = s1[u], one2 = f1[u + 1], two2 = s1[u + 1];
    const float one3 = f2[u], two3 = s2[u], one4 = f2[u + 1], two4 = s2[u + 1];
    // d and c of the cells before; b and a of those after.
    float sum = ((cell1[u] & kCutFromBToC) != 0 ? 0.0F : one1) + two1;
    sum += (cell1[u + 1] & kCutFromBToC) != 0 ? one2 : 0.0F;
    sum = sum + two2 + one3;
    sum += (cell2[u] & kCutFromBToC) != 0 ? two3 : 0.0F;
    sum += one4;
    to[u] = sum + ((cell2[u + 1] & kCutFromBToC) != 0 ? 0.0F : two4);
  }
}

}  // namespace

namespace {

/// The box around points, those of a row at a time: four of them are twelve numbers.
class RowBox {
 public:
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

void Surface::load_samples(const PointGridView& grid, int num_threads) {
  const auto size = std::int64_t{cols_} * rows_;
  samples_.resize(size);
  valid_.assign(size, 0);
  const double scale = 1.0 / unit_;
  parallel_chunks(used_rows_, kRowsPerChunk, num_threads,
                  [&](std::int64_t begin, std::int64_t end) {
                    for (std::int64_t v = begin; v < end; ++v) {
                      const std::int64_t from = (v + v0_) * grid.cols + u0_;
                      Sample* row = samples_.data() + v * cols_;
                      for (std::int64_t u = 0; u < used_cols_; ++u) {
                        const std::uint8_t valid = grid.valid[from + u];
                        valid_[v * cols_ + u] = valid;
                        row[u] = {};
                        if (valid == 0) continue;
                        const float* p = grid.points + 3 * (from + u);
                        row[u].x = static_cast<float>((p[0] - center_.x()) * scale);
                        row[u].y = static_cast<float>((p[1] - center_.y()) * scale);
                        row[u].z = static_cast<float>((p[2] - center_.z()) * scale);
                      }
                      std::fill(row + used_cols_, row + cols_, Sample{});
                    }
                  });
  std::fill(samples_.begin() + std::int64_t{used_rows_} * cols_, samples_.end(), Sample{});
}

void Surface::cut_cells(const DenseRule& rule, int num_threads) {
  cells_.assign(samples_.size(), 0);
  // Each chunk of rows has its own part of the scratch, whichever thread takes it.
  const std::int64_t size = (used_rows_ + kRowsPerChunk - 1) / kRowsPerChunk * used_cols_;
  make_room(row_floats_, size * CellRows::kFloatRows);
  row_floats_.resize(static_cast<std::size_t>(size * CellRows::kFloatRows));
  make_room(row_bits_, size);
  row_bits_.resize(size);
  // A function object of two references needs no memory of its own.
  parallel_chunks(
      used_rows_ - 1, kRowsPerChunk, num_threads,
      [this, &rule](std::int64_t begin, std::int64_t end) { cut_rows(rule, begin, end); });
}

void Surface::cut_rows(const DenseRule& rule, std::int64_t begin, std::int64_t end) {
  const double limit = rule.max_edge / unit_;
  const std::array<std::uint8_t, kAllCellBits>& cell_by_bits = cells_by_bits();
  const auto width = static_cast<std::size_t>(used_cols_);
  const std::int64_t first = begin / kRowsPerChunk * used_cols_;
  CellRows rows({row_floats_.data() + first * CellRows::kFloatRows, width},
                {row_bits_.data() + first, width}, static_cast<float>(limit * limit));
  rows.start(used_row(static_cast<int>(begin)));
  for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
    const std::span<const std::uint16_t> bits = rows.next(used_row(v + 1));
    const std::uint8_t* above = valid_.data() + std::ptrdiff_t{v} * cols_;
    const std::uint8_t* below = above + cols_;
    std::uint8_t* cells = cells_.data() + std::ptrdiff_t{v} * cols_;
    for (int u = 0; u + 1 < used_cols_; ++u) {
      const unsigned valid = above[u] | above[u + 1] << 1U | below[u + 1] << 2U | below[u] << 3U;
      cells[u] = cell_by_bits[bits[u] | valid];
    }
    if (steps_.has_steps()) {
      cut_steps(v, rows.z_above(), rows.z_below(), {row_bits_.data() + first, width});
    }
  }
}

void Surface::cut_steps(int v, std::span<const float> z_above, std::span<const float> z_below,
                        std::span<std::uint16_t> stepped) {
  const StepRule steps = steps_;
  const double unit = unit_, middle = center_.z();
  const auto is_step = [&](float low, float high) {
    const auto nearest = static_cast<float>(unit * low + middle);
    return !(unit * double{high - low} <= double{steps.limit(nearest)});
  };
  // Whole cells without a step have none in their halves either: four of them at a time.
  const std::ptrdiff_t size = std::ptrdiff_t{used_cols_} - 1;
  const float *above = z_above.data(), *below = z_below.data();
  const auto lower = [](Float4 p, Float4 q) { return p < q ? p : q; };
  const auto higher = [](Float4 p, Float4 q) { return p > q ? p : q; };
  std::ptrdiff_t first = 0;
  for (; first + 4 <= size; first += 4) {
    const Float4 a = load4(above + first), b = load4(above + first + 1);
    const Float4 c = load4(below + first), d = load4(below + first + 1);
    const Float4 low = lower(lower(a, b), lower(c, d));
    const Float4 height = higher(higher(a, b), higher(c, d)) - low;
    const Float4 limit = steps.limit(affine4(unit, low, middle));
    const auto first_two = unit * low_doubles(height) <= low_doubles(limit);
    const auto last_two = unit * high_doubles(height) <= high_doubles(limit);
    for (int i = 0; i < 2; ++i) {
      stepped[first + i] = first_two[i] != 0 ? 0 : 1;
      stepped[first + 2 + i] = last_two[i] != 0 ? 0 : 1;
    }
  }
  for (; first < size; ++first) {
    const auto [low, high] =
        std::minmax({above[first], above[first + 1], below[first], below[first + 1]});
    stepped[first] = is_step(low, high) ? 1 : 0;
  }
  for (int u = 0; u + 1 < used_cols_; ++u) {
    const std::int32_t a = v * cols_ + u;
    std::uint8_t& cell = cells_[a];
    if (cell == 0 || ((cell & kFull) == kFull && stepped[u] == 0)) continue;
    for (const bool second : {false, true}) {
      const std::uint8_t half = second ? kSecond : kFirst;
      if ((cell & half) == 0) continue;
      const auto [p, q, r] = cell_triangle(cell, second, a, cols_);
      const auto [least, most] = std::minmax({samples_[p].z, samples_[q].z, samples_[r].z});
      if (is_step(least, most)) cell &= static_cast<std::uint8_t>(~half);
    }
    if ((cell & kFull) == 0) cell = 0;
  }
}

void Surface::add_areas() {
  constexpr std::int64_t kFloatRows = 4 + 6 + 1;
  const std::int64_t padded_cols = std::int64_t{used_cols_} + 4;
  const auto width = static_cast<std::size_t>(padded_cols);
  make_room(row_floats_, kFloatRows * padded_cols);
  row_floats_.resize(kFloatRows * width);
  make_room(row_cells_, 2 * padded_cols);
  row_cells_.resize(2 * width);
  Rooms<float> rooms(row_floats_.data(), width);
  // Areas of the cells below and above a row of pixels.
  AreaRow before(rooms, {row_cells_.data(), width});
  AreaRow row(rooms, {row_cells_.data() + width, width});
  CoordinateRow points(rooms), next(rooms);
  const std::span<float> weights = rooms.row().first(used_cols_);
  for (AreaRow* areas : {&before, &row}) areas->clear();
  num_faces_ = 0;
  points.assign(used_row(0));
  for (int v = 0; v < used_rows_; ++v) {
    std::swap(before, row);
    if (v + 1 < used_rows_) {
      next.assign(used_row(v + 1));
      const std::span cells(cells_.data() + std::ptrdiff_t{v} * cols_,
                            static_cast<std::size_t>(used_cols_ - 1));
      row.assign(points, next, cells);
      int halves = 0;
      for (const std::uint8_t cell : cells) halves += (cell & 1) + (cell >> 1 & 1);
      num_faces_ += halves;
      std::swap(points, next);
    } else {
      row.clear();
    }
    add_corners(before, row, weights);
    Sample* const samples = samples_.data() + std::ptrdiff_t{v} * cols_;
    for (int u = 0; u < used_cols_; ++u) samples[u].weight = weights[u];
  }
  count_used();
}

void Surface::count_used() {
  used_.resize(samples_.size());
  const Sample* const samples = samples_.data();
  std::uint8_t* const used = used_.data();
  const auto size = static_cast<std::ptrdiff_t>(samples_.size());
  for (std::ptrdiff_t p = 0; p < size; ++p) used[p] = samples[p].weight > 0.0F ? 1 : 0;
  double total = 0.0;
  std::int32_t count = 0;
  for (std::ptrdiff_t p = 0; p < size; ++p) {
    total += samples[p].weight;
    count += used[p];
  }
  num_used_ = count;
  mean_area_ =
      static_cast<float>(total / static_cast<double>(std::max<std::int64_t>(num_used_, 1)));
}

void Surface::weigh(const PointGridView& grid, std::span<const float> confidence) {
  confidence_.clear();
  mean_confidence_ = 1.0F;
  if (confidence.empty()) return;
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
  if (sum > 0.0) mean_confidence_ = static_cast<float>(sum / static_cast<double>(num_used_));
}

void Surface::assign(const PointGridView& whole, const DenseRule& rule,
                     std::span<const float> confidence, int num_threads) {
  step_ = 1;
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
  load_samples(grid, num_threads);
  cut_cells(rule, num_threads);
  add_areas();
  weigh(grid, confidence);
}

void Surface::assign_half(const Surface& whole) {
  step_ = 2;
  u0_ = whole.u0_ + (whole.u0_ & 1);
  v0_ = whole.v0_ + (whole.v0_ & 1);
  used_cols_ = (whole.used_cols_ - (u0_ - whole.u0_) + 1) / 2;
  used_rows_ = (whole.used_rows_ - (v0_ - whole.v0_) + 1) / 2;
  unit_ = whole.unit_;
  center_ = whole.center_;
  steps_ = whole.steps_;
  num_valid_ = whole.num_valid_;
  mean_confidence_ = whole.mean_confidence_;
  num_faces_ = num_used_ = 0;
  if (used_cols_ < 1 || used_rows_ < 1) return;
  cols_ = padded(used_cols_);
  rows_ = padded(used_rows_);
  const auto size = std::int64_t{cols_} * rows_;
  samples_.assign(size, {});
  valid_.assign(size, 0);
  confidence_.assign(whole.has_confidence() ? size : 0, 0.0F);
  cells_.assign(size, 0);
  const auto pixel_of_whole = [&](int u, int v) {
    return (2 * v + v0_ - whole.v0_) * whole.cols_ + 2 * u + u0_ - whole.u0_;
  };
  for (int v = 0; v < used_rows_; ++v) {
    const std::int32_t to = v * cols_, from = pixel_of_whole(0, v);
    for (int u = 0; u < used_cols_; ++u) samples_[to + u] = whole.samples_[from + 2 * u];
    for (int u = 0; u < used_cols_; ++u) valid_[to + u] = whole.valid_[from + 2 * u];
    if (!has_confidence()) continue;
    for (int u = 0; u < used_cols_; ++u) confidence_[to + u] = whole.confidence_[from + 2 * u];
  }
  for (int v = 0; v + 1 < used_rows_; ++v) {
    for (int u = 0; u + 1 < used_cols_; ++u) {
      const std::int32_t a = v * cols_ + u;
      const Vec3 ad = samples_[a + cols_ + 1].point() - samples_[a].point();
      const Vec3 bc = samples_[a + cols_].point() - samples_[a + 1].point();
      const std::uint8_t* const cell = whole.cells_.data() + pixel_of_whole(u, v);
      cells_[a] = cell_of_four({cell[0], cell[1], cell[whole.cols_], cell[whole.cols_ + 1]},
                               bc.squaredNorm() < ad.squaredNorm());
    }
  }
  add_areas();
  for (std::size_t p = 0; p < confidence_.size(); ++p) samples_[p].weight *= confidence_[p];
}

std::int32_t Surface::pixel_at(std::int64_t input_u, std::int64_t input_v) const {
  const std::int64_t du = input_u - u0_, dv = input_v - v0_;
  if (du < 0 || dv < 0 || du / step_ >= cols_ || dv / step_ >= rows_) return -1;
  return static_cast<std::int32_t>(dv / step_ * cols_ + du / step_);
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
