#include "simplify/relief_surface.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "geometry/cell_cut.hpp"
#include "geometry/constants.hpp"
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

float squared_distance(const Sample& p, const Sample& q) {
  return (p.point() - q.point()).squaredNorm();
}

}  // namespace

bool Surface::crop(const PointGridView& grid) {
  Eigen::Vector3d low = Eigen::Vector3d::Constant(kInfinity), high = -low;
  std::int64_t first_u = grid.cols, last_u = -1, first_v = grid.rows, last_v = -1;
  for (std::int64_t v = 0; v < grid.rows; ++v) {
    const std::uint8_t* valid = grid.valid + v * grid.cols;
    const float* point = grid.points + v * grid.cols * 3;
    std::int64_t row_first = grid.cols, row_last = -1;
    Eigen::Array3f row_low = Eigen::Array3f::Constant(std::numeric_limits<float>::infinity());
    Eigen::Array3f row_high = -row_low;
    for (std::int64_t u = 0; u < grid.cols; ++u) {
      if (valid[u] == 0) continue;
      row_first = std::min(row_first, u);
      row_last = u;
      const Eigen::Array3f p = Eigen::Map<const Eigen::Array3f>(point + 3 * u);
      row_low = row_low.min(p);
      row_high = row_high.max(p);
    }
    if (row_last < 0) continue;
    low = low.cwiseMin(row_low.cast<double>().matrix());
    high = high.cwiseMax(row_high.cast<double>().matrix());
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
  const double diagonal = (high - low).norm();
  unit_ = diagonal > 0.0 ? diagonal : 1.0;
  center_ = 0.5 * low + 0.5 * high;
  return true;
}

void Surface::load_samples(const PointGridView& grid, int num_threads) {
  const auto size = static_cast<std::size_t>(cols_) * static_cast<std::size_t>(rows_);
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
  const double limit = rule.max_edge / unit_;
  const auto max_squared = static_cast<float>(limit * limit);
  const bool any_length = !std::isfinite(rule.max_edge), any_step = !std::isfinite(rule.max_step);
  const auto keeps = [&](const std::array<std::int32_t, 3>& t) {
    const Sample &p = samples_[t[0]], &q = samples_[t[1]], &r = samples_[t[2]];
    const auto [low, high] = std::minmax({p.z, q.z, r.z});
    return (any_length ||
            (squared_distance(p, q) <= max_squared && squared_distance(q, r) <= max_squared &&
             squared_distance(r, p) <= max_squared)) &&
           (any_step || unit_ * double{high - low} <= rule.max_step * (unit_ * low + center_.z()));
  };
  parallel_chunks(
      used_rows_ - 1, kRowsPerChunk, num_threads, [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t v = begin; v < end; ++v) {
          for (int u = 0; u + 1 < used_cols_; ++u) {
            const auto a = static_cast<std::int32_t>(v * cols_ + u);
            const std::int32_t b = a + 1, c = a + cols_, d = c + 1;
            const std::array<std::int32_t, 4> corner = {a, b, d, c};
            const unsigned valid = valid_[a] | valid_[b] << 1U | valid_[d] << 2U | valid_[c] << 3U;
            std::uint8_t cell = cell_of(cut_cell(valid, [&](int i, int j) {
              return squared_distance(samples_[corner[i]], samples_[corner[j]]);
            }));
            if ((cell & kFirst) != 0 && !keeps(cell_triangle(cell, false, a, cols_))) {
              cell &= static_cast<std::uint8_t>(~kFirst);
            }
            if ((cell & kSecond) != 0 && !keeps(cell_triangle(cell, true, a, cols_))) {
              cell &= static_cast<std::uint8_t>(~kSecond);
            }
            cells_[a] = (cell & kFull) == 0 ? std::uint8_t{0} : cell;
          }
        }
      });
}

void Surface::add_areas() {
  constexpr float kSixth = 1.0F / 6.0F;  // half a cross product for each of three corners
  num_faces_ = num_used_ = 0;
  const auto add = [&](const std::array<std::int32_t, 3>& t) {
    const Vec3 p = samples_[t[0]].point();
    const Vec3 q = samples_[t[1]].point(), r = samples_[t[2]].point();
    const float third = kSixth * (q - p).cross(r - p).norm();
    for (const std::int32_t pixel : t) samples_[pixel].weight += third;
    ++num_faces_;
  };
  for (int v = 0; v + 1 < used_rows_; ++v) {
    for (int u = 0; u + 1 < used_cols_; ++u) {
      const std::int32_t a = v * cols_ + u;
      const std::uint8_t cell = cells_[a];
      if ((cell & kFirst) != 0) add(cell_triangle(cell, false, a, cols_));
      if ((cell & kSecond) != 0) add(cell_triangle(cell, true, a, cols_));
    }
  }
  double total = 0.0;
  used_.resize(samples_.size());
  for (std::size_t p = 0; p < samples_.size(); ++p) {
    used_[p] = samples_[p].weight > 0.0F ? 1 : 0;
    num_used_ += used_[p];
    total += samples_[p].weight;
  }
  mean_area_ =
      static_cast<float>(total / static_cast<double>(std::max<std::int64_t>(num_used_, 1)));
}

void Surface::weigh(const PointGridView& grid, std::span<const float> confidence) {
  confidence_.clear();
  if (confidence.empty()) return;
  confidence_.assign(samples_.size(), 0.0F);
  for (int v = 0; v < used_rows_; ++v) {
    const float* from = confidence.data() + (v + v0_) * grid.cols + u0_;
    std::copy(from, from + used_cols_, confidence_.begin() + std::ptrdiff_t{v} * cols_);
  }
  for (std::size_t p = 0; p < samples_.size(); ++p) samples_[p].weight *= confidence_[p];
}

void Surface::assign(const PointGridView& grid, const DenseRule& rule,
                     std::span<const float> confidence, int num_threads) {
  num_faces_ = num_used_ = 0;
  if (!crop(grid)) return;
  cols_ = padded(used_cols_);
  rows_ = padded(used_rows_);
  load_samples(grid, num_threads);
  cut_cells(rule, num_threads);
  add_areas();
  weigh(grid, confidence);
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
