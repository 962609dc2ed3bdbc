#include "simplify/relief/start.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>

namespace manip3d::relief_detail {
namespace {

constexpr float kMustSplit = std::numeric_limits<float>::infinity();
constexpr float kNoTriangle = -1.0F;  // the pixel is in no dense triangle
constexpr float kAllNotFlat = std::numeric_limits<float>::denorm_min();
constexpr int kTile = Surface::kTile;

/// Errors are counted by their upper bits, which have the same order.
constexpr int kErrorShift = 19;
constexpr std::uint32_t kRowsPerTick = 16;

std::size_t bucket_of(float error) { return std::bit_cast<std::uint32_t>(error) >> kErrorShift; }

/// Distance of a point from a line. It is zero on planes, because straight lines of pixels are
/// straight lines in space there, for every camera.
inline float distance_from_line(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 along = b - a;
  const float length = along.squaredNorm();
  return length > 0.0F ? std::sqrt((p - a).cross(along).squaredNorm() / length) : 0.0F;
}

bool is_kept(std::span<const Keep> keep, std::int32_t pixel) {
  return !keep.empty() && keep[pixel] != Keep::kFree;
}

bool is_odd(int i) { return (i & 1) != 0; }

// Coordinates of vertices are counted in steps. If one is odd and the other even, the vertex is a
// "side": it halves a side of a square of two steps. If both are odd, it is a "diagonal": it halves
// the diagonal of such a square.

/// Direction of the diagonal of the square of two steps around (u, v). With corners numbered in
/// units of the square's side, the diagonal joins the corner with two even numbers to the one with
/// two odd numbers.
int diagonal_direction(int u, int v, int step) {
  const int i = (u - step) / (2 * step), j = (v - step) / (2 * step);
  return is_odd(i) == is_odd(j) ? 1 : -1;  // v grows with u along it, or decreases
}

}  // namespace

void StartMesh::measure_pixels(const Surface& surface) {
  const int cols = surface.cols(), rows = surface.rows();
  for (int v = 0; v < rows; ++v) {
    for (int u = is_odd(v) ? 0 : 1; u < cols; u += 2) {
      const std::int32_t p = v * cols + u;
      int full = 0, some = 0, cells = 0;
      if (u > 0 && v > 0 && u + 1 < cols && v + 1 < rows) {
        const unsigned all = surface.cell(p) & surface.cell(p - 1) & surface.cell(p - cols) &
                             surface.cell(p - cols - 1) & kFull;
        if (all == kFull) {
          errors_[p] = 0.0F;
          continue;
        }
      }
      for (int dv = -1; dv <= 0; ++dv) {
        for (int du = -1; du <= 0; ++du) {
          if (u + du < 0 || v + dv < 0 || u + du >= cols - 1 || v + dv >= rows - 1) continue;
          const int halves = surface.cell(p + dv * cols + du) & kFull;
          ++cells;
          full += halves == kFull ? 1 : 0;
          some += halves != 0 ? 1 : 0;
        }
      }
      errors_[p] = some == 0 ? kNoTriangle : full == cells ? 0.0F : kMustSplit;
    }
  }
}

/// Raises the errors of four bisections in a row to their own errors: the distance of the pixel
/// from the line between two others, times the area around it. Errors of pixels that are not
/// measured do not change.
Float4 StartMesh::raised(const Surface& surface, Float4 errors, std::int32_t first, int stride,
                         const std::array<std::int32_t, 4>& away, float weight) const {
  const auto lanes = [&](auto&& pixel) {
    return transpose({load4(&surface.sample(pixel(0)).x), load4(&surface.sample(pixel(1)).x),
                      load4(&surface.sample(pixel(2)).x), load4(&surface.sample(pixel(3)).x)});
  };
  const auto [px, py, pz, area] = lanes([&](int i) { return first + i * stride; });
  const auto [ax, ay, az, area_a] = lanes([&](int i) { return first + i * stride - away[i]; });
  const auto [bx, by, bz, area_b] = lanes([&](int i) { return first + i * stride + away[i]; });
  // The same operations as in distance_from_line(), so that the bits are equal.
  const Float4 x1 = px - ax, y1 = py - ay, z1 = pz - az, x2 = bx - ax, y2 = by - ay, z2 = bz - az;
  const Float4 x = y1 * z2 - z1 * y2, y = z1 * x2 - x1 * z2, z = x1 * y2 - y1 * x2;
  const Float4 squared = x * x + (y * y + z * z), length = x2 * x2 + (y2 * y2 + z2 * z2);
  const Int4 is_line = length > 0.0F;
  const Float4 root = sqrt4(squared / (is_line ? length : all_of(1.0F)));
  Float4 counted = area;
  if (!by_blocks_) {
    for (int i = 0; i < 4; ++i) counted[i] = surface.confidence(first + i * stride);
  }
  const Float4 own = (is_line ? root : all_of(0.0F)) * weight * counted;
  const Int4 can_rise = (errors >= 0.0F) & (errors < kMustSplit) & (errors < own);
  return can_rise ? own : errors;
}

/// Measures a row of bisections: the errors of their parts, raised to their own.
/// @param part  Maps a column to the largest error of the parts.
/// @param away  Maps a column to the offset of the ends of the halved edge.
template <typename Part, typename Away>
void StartMesh::measure_row(const Surface& surface, std::span<const Keep> keep, int v, int first,
                            int step, bool is_measured, Part&& part, Away&& away) {
  const int cols = surface.cols(), stride = 2 * step;
  const float weight = static_cast<float>(step * step);
  const auto put = [&](std::int32_t p, float error) {
    errors_[p] = is_kept(keep, p) && error >= 0.0F ? kMustSplit : error;
  };
  int u = first;
  for (; u + 3 * stride < cols; u += 4 * stride) {
    const std::int32_t p = v * cols + u;
    Float4 errors = {part(u), part(u + stride), part(u + 2 * stride), part(u + 3 * stride)};
    if (is_measured && true_lanes((errors >= 0.0F) & (errors < kMustSplit)) != 0) {
      errors =
          raised(surface, errors, p, stride,
                 {away(u), away(u + stride), away(u + 2 * stride), away(u + 3 * stride)}, weight);
    }
    for (int i = 0; i < 4; ++i) put(p + i * stride, errors[i]);
  }
  for (; u < cols; u += stride) {
    const std::int32_t p = v * cols + u;
    float error = part(u);
    if (is_measured && error >= 0.0F && error < kMustSplit) {
      const float own =
          distance_from_line(surface.sample(p).point(), surface.sample(p - away(u)).point(),
                             surface.sample(p + away(u)).point());
      error = std::max(error, own * weight * weight_of(surface, p));
    }
    put(p, error);
  }
}

void StartMesh::measure_sides(const Surface& surface, int finest, std::span<const Keep> keep,
                              int step, Ticker& ticker) {
  const int cols = surface.cols(), rows = surface.rows();
  const int h = step / 2;
  for (int v = 0; v < rows; v += step) {
    ticker.tick();
    const bool odd_row = is_odd(v / step);
    const std::int32_t away = odd_row ? step * cols : step;
    const bool below = v > 0, above = v + h < rows;
    const auto part = [&](int u) {
      const std::int32_t p = v * cols + u;
      if (step == 1) return errors_[p];
      float error = kNoTriangle;
      if (by_blocks_ && step == ContourBlocks::kSize &&
          blocks_.around(u, v) == ContourBlocks::State::kCut) {
        error = kMustSplit;
      }
      const bool left = u > 0, right = u + h < cols;
      if (below) {
        if (left) error = std::max(error, errors_[p - h * cols - h]);
        if (right) error = std::max(error, errors_[p - h * cols + h]);
      }
      if (above) {
        if (left) error = std::max(error, errors_[p + h * cols - h]);
        if (right) error = std::max(error, errors_[p + h * cols + h]);
      }
      return error;
    };
    measure_row(surface, keep, v, odd_row ? 0 : step, step, step >= finest, part,
                [away](int) { return away; });
  }
}

void StartMesh::measure_diagonals(const Surface& surface, int finest, std::span<const Keep> keep,
                                  int step, Ticker& ticker) {
  const int cols = surface.cols(), rows = surface.rows();
  for (int v = step; v < rows; v += 2 * step) {
    ticker.tick();
    const auto part = [&](int u) {
      if (is_left_out(u, v, step)) return kNoTriangle;
      const std::int32_t p = v * cols + u;
      return std::max(std::max(errors_[p - step], errors_[p + step]),
                      std::max(errors_[p - step * cols], errors_[p + step * cols]));
    };
    measure_row(surface, keep, v, step, step, step >= finest, part,
                [&](int u) { return step * cols + step * diagonal_direction(u, v, step); });
  }
}

void StartMesh::measure(const Surface& surface, int finest, std::span<const Keep> keep,
                        Ticker& ticker) {
  errors_.resize(std::int64_t{surface.cols()} * surface.rows());
  if (by_blocks_) {
    blocks_.fill(surface.cols(), 0.0F, kNoTriangle, errors_);
  } else {
    measure_pixels(surface);
  }
  for (int step = 1; step < kTile; step *= 2) {
    // With step 1 and a coarser finest grid, measure_sides() would not change anything.
    if (step > 1 || finest == 1 || !keep.empty())
      measure_sides(surface, finest, keep, step, ticker);
    measure_diagonals(surface, finest, keep, step, ticker);
  }
  for (int v = 0; v < surface.rows(); v += kTile) {
    for (int u = 0; u < surface.cols(); u += kTile) errors_[v * surface.cols() + u] = kNoTriangle;
  }
}

/// Counts the errors of every step-th pixel and row that are at least `least`.
void StartMesh::count_errors(const Surface& surface, int step, float least) {
  const int cols = surface.cols();
  histogram_.assign(std::size_t{1} << (31 - kErrorShift), 0);
  const auto count = [&](float error) {
    if (error >= least && error < kMustSplit) ++histogram_[bucket_of(error)];
  };
  // Tests four neighbours at once, because most are below `least`.
  const unsigned in_step = step == 1 ? 15U : step == 2 ? 5U : 1U;
  const int stride = std::max(step, 4);
  for (int v = 0; v < surface.rows(); v += step) {
    const float* const row = errors_.data() + std::ptrdiff_t{v} * cols;
    int u = 0;
    for (; u + 4 <= cols; u += stride) {
      const Float4 errors = load4(row + u);
      const Int4 counted = (errors >= least) & (errors < kMustSplit);
      for (unsigned lanes = true_lanes(counted) & in_step; lanes != 0; lanes &= lanes - 1) {
        ++histogram_[bucket_of(row[u + std::countr_zero(lanes)])];
      }
    }
    for (; u < cols; u += step) count(row[u]);
  }
}

/// The least of the `num_vertices` largest errors that were counted, rounded to the histogram.
float StartMesh::counted_threshold(std::int64_t num_vertices) const {
  std::int64_t left = num_vertices;
  std::size_t bucket = histogram_.size();
  while (bucket > 0 && left >= histogram_[bucket - 1]) left -= histogram_[--bucket];
  if (bucket == histogram_.size()) return kMustSplit;
  if (bucket == 0) return kAllNotFlat;
  return std::bit_cast<float>(static_cast<std::uint32_t>(bucket << kErrorShift));
}

float StartMesh::threshold_for(const Surface& surface, std::int64_t num_vertices, int finest) {
  // The threshold of all pixels is at least that of one pixel in sixteen, which is found quickly;
  // smaller errors need not be counted.
  count_errors(surface, 4 * finest, kAllNotFlat);
  const float least = counted_threshold(num_vertices);
  if (least == kMustSplit) return least;
  count_errors(surface, finest, least);
  return std::max(least, counted_threshold(num_vertices));
}

void StartMesh::find_busy_tiles(const Surface& surface, float threshold) {
  constexpr int kHalf = kTile / 2;
  busy_.clear();
  for (int v = kHalf; v < surface.rows(); v += kTile) {
    for (int u = kHalf; u < surface.cols(); u += kTile) {
      busy_.push_back(errors_[v * surface.cols() + u] >= threshold ? 1 : 0);
    }
  }
}

/// Visits every stride-th pixel of row v in busy tiles, from `first` to below `end`. A border pixel
/// belongs to the next tile.
template <typename Visit>
void StartMesh::visit_busy(int cols, int v, int first, int stride, int end, Visit&& visit) {
  const int across = cols / kTile, down = static_cast<int>(busy_.size()) / across;
  const std::uint8_t* const busy = busy_.data() + std::min(v / kTile, down - 1) * across;
  for (int tile = 0; tile < across; ++tile) {
    if (busy[tile] == 0) continue;
    const int stop = tile + 1 < across ? (tile + 1) * kTile : end;
    for (int u = tile * kTile + first; u < stop; u += stride) visit(u);
  }
}

void StartMesh::emit_cells(const Surface& surface, float threshold) {
  const int cols = surface.cols();
  const auto emit_cell = [&](int u, int v) {
    const std::int32_t a = v * cols + u, b = a + 1, c = a + cols, d = c + 1;
    const std::uint8_t cell = surface.cell(a);
    if ((cell & kFull) == 0) return;
    // The two corners at which a side may be halved: b and c, or a and d.
    const bool at_bc = is_odd(u) == is_odd(v);
    const bool first = errors_[at_bc ? b : a] >= threshold;
    const bool second = errors_[at_bc ? c : d] >= threshold;
    if (first && second) {
      if ((cell & kFirst) != 0) faces_.push_back(cell_triangle(cell, false, a, cols));
      if ((cell & kSecond) != 0) faces_.push_back(cell_triangle(cell, true, a, cols));
    } else if (first || second) {  // half of the cell; the other half is in a larger triangle
      const std::uint8_t cut = at_bc ? kFull : kFull | kCutFromBToC;
      faces_.push_back(cell_triangle(cut, second, a, cols));
    }
  };
  // The error of a diagonal is at least that of the sides around it. If it is below the threshold,
  // so are all corners of its four cells; this also holds in squares that are left out.
  for (int v = 0; v + 1 < surface.rows(); ++v) {
    const float* const diagonals = errors_.data() + std::ptrdiff_t{v | 1} * cols + 1;
    visit_busy(cols, v, 0, 2, cols - 1, [&](int u) {
      if (!(diagonals[u] >= threshold)) return;
      emit_cell(u, v);
      emit_cell(u + 1, v);
    });
  }
}

void StartMesh::emit_fans(const Surface& surface, float threshold, int step) {
  const int cols = surface.cols(), rows = surface.rows();
  const auto emit = [&](std::int32_t p, std::int32_t q, std::int32_t r) {
    faces_.push_back({p, q, r});
  };
  const auto is_flat = [&](std::int32_t p) { return errors_[p] >= 0.0F && errors_[p] < threshold; };
  // Around halved diagonals: those of the four quarters of the square whose outer side is not
  // halved.
  for (int v = step; v < rows; v += 2 * step) {
    visit_busy(cols, v, step, 2 * step, cols, [&](int u) {
      const std::int32_t m = v * cols + u;
      if (!(errors_[m] >= threshold)) return;
      const std::int32_t du = step, dv = step * cols;
      if (is_flat(m - dv)) emit(m, m - dv - du, m - dv + du);
      if (is_flat(m + du)) emit(m, m + du - dv, m + du + dv);
      if (is_flat(m + dv)) emit(m, m + dv + du, m + dv - du);
      if (is_flat(m - du)) emit(m, m - du + dv, m - du - dv);
    });
  }
  if (step == 1) return;
  // Around halved sides: those of up to four halves of the quarters whose long side is not halved.
  const int h = step / 2;
  for (int v = 0; v < rows; v += step) {
    const bool odd_row = is_odd(v / step);
    visit_busy(cols, v, odd_row ? 0 : step, 2 * step, cols, [&](int u) {
      const std::int32_t m = v * cols + u;
      if (!(errors_[m] >= threshold)) return;
      const std::int32_t du = step, dv = step * cols;
      const bool left = u > 0, right = u + step < cols, below = v > 0, above = v + step < rows;
      if (right && above && is_flat(m + h + h * cols)) emit(m, m + du, m + dv);
      if (left && above && is_flat(m - h + h * cols)) emit(m, m + dv, m - du);
      if (left && below && is_flat(m - h - h * cols)) emit(m, m - du, m - dv);
      if (right && below && is_flat(m + h - h * cols)) emit(m, m - dv, m + du);
    });
  }
}

void StartMesh::emit(const Surface& surface, float threshold, std::span<const Keep> keep) {
  const int cols = surface.cols();
  const int half = kTile / 2;
  faces_.clear();
  find_busy_tiles(surface, threshold);
  for (int v = half; v < surface.rows(); v += kTile) {
    for (int u = half; u < cols; u += kTile) {
      const std::int32_t m = v * cols + u;
      if (!(errors_[m] >= 0.0F && errors_[m] < threshold)) continue;
      const std::int32_t a = m - half - half * cols, b = a + kTile, c = a + kTile * cols,
                         d = c + kTile;
      if (diagonal_direction(u, v, half) > 0) {
        faces_.push_back({a, b, d});
        faces_.push_back({a, d, c});
      } else {
        faces_.push_back({a, b, c});
        faces_.push_back({b, d, c});
      }
    }
  }
  for (int step = half; step >= 1; step /= 2) emit_fans(surface, threshold, step);
  emit_cells(surface, threshold);
  if (by_blocks_) blocks_.emit(surface, errors_, threshold, keep, faces_);
}

std::span<const Triangle> StartMesh::build(const Surface& surface, std::int64_t num_vertices,
                                           int finest, std::span<const Keep> keep, bool by_blocks,
                                           const Progress& progress) {
  Ticker ticker(progress, kRowsPerTick);
  by_blocks_ = by_blocks;
  if (by_blocks) blocks_.assign(surface);
  measure(surface, finest, keep, ticker);
  if (progress) progress(0.0);
  emit(surface, threshold_for(surface, num_vertices, finest), keep);
  return faces_;
}

std::span<const Triangle> StartMesh::order_by_tile(const Surface& surface) {
  const int across = surface.cols() / kTile + 1;
  const auto tile_of = [&](const Triangle& t) {
    const int v = surface.v(t[0]), u = t[0] - v * surface.cols();
    return v / kTile * across + u / kTile;
  };
  first_in_.assign(static_cast<std::size_t>(across) * (surface.rows() / kTile + 1) + 1, 0);
  make_room(tiles_, static_cast<std::int64_t>(faces_.size()));
  tiles_.clear();
  for (const Triangle& t : faces_) {
    tiles_.push_back(tile_of(t));
    ++first_in_[tiles_.back() + 1];
  }
  std::partial_sum(first_in_.begin(), first_in_.end(), first_in_.begin());
  make_room(ordered_, static_cast<std::int64_t>(faces_.size()));
  ordered_.resize(faces_.size());
  for (std::size_t i = 0; i < faces_.size(); ++i) ordered_[first_in_[tiles_[i]]++] = faces_[i];
  return ordered_;
}

}  // namespace manip3d::relief_detail
