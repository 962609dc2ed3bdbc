#include "simplify/relief/pinholes.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstring>

namespace manip3d::relief_detail {
namespace {

/// Least share of the pixels in pinholes for which filling pays. With fewer, treating them as ends
/// of the surface costs less time than a second surface (on real images with 4 to 300 pinholes,
/// filling took a fifth longer).
constexpr double kMinShare = 1e-3;

/// Share of the pixels that are missing amid a surface from which on they are missing by chance.
/// Images of real cameras have at most 0.01 here; a random loss of 3 % of the pixels gives 0.029.
constexpr double kChanceShare = 0.02;

/// The least number of such pixels: fewer are no evidence.
constexpr double kChancePixels = 50.0;

/// Rounds of averaging neighbours. After these, the remaining error in a hole of four pixels is
/// less than a millionth of the difference between its neighbours.
constexpr int kRounds = 24;

/// Measured pixels beside a pixel from which on farther ones need not be looked at.
constexpr int kEnough = 3;

using Point = Eigen::Map<const Eigen::Vector3f>;

std::uint64_t eight_bytes(const std::uint8_t* from) {
  std::uint64_t bytes = 0;
  std::memcpy(&bytes, from, sizeof bytes);
  return bytes;
}

}  // namespace

/// Visits the eight pixels around one that is not on the border of the grid.
template <typename Visit>
void PinholeFiller::visit_around(std::int64_t pixel, Visit&& visit) const {
  for (const std::int64_t row : {-grid_.cols, std::int64_t{0}, grid_.cols}) {
    for (const std::int64_t column : {-1, 0, 1}) {
      if (row != 0 || column != 0) visit(pixel + row + column);
    }
  }
}

bool PinholeFiller::fill(const PointGridView& grid, const DenseRule& rule,
                         std::span<const float> confidence, const Surface& surface) {
  grid_ = grid;
  clear();
  if (grid.rows < 3 || grid.cols < 3) return false;
  const StepRule steps(rule);
  const auto num_pixels = static_cast<double>(grid.rows * grid.cols);
  find_unseen(steps, surface);
  by_chance_ = find_chance(steps, rule.max_edge);
  if (!by_chance_) find_pinholes(steps, rule.max_edge);
  const bool is_worth = static_cast<double>(num_filled_) >= kMinShare * num_pixels;
  if (is_worth && num_filled_ > 0) {
    fill_in(confidence);
  } else {
    num_filled_ = 0;
  }
  if (grid.rows * grid.cols > kManyPixels) {
    release(holes_);
    release(hole_at_);
    release(open_);
    release(gaps_);
    release(gaps_of_rows_);
  }
  return num_filled_ > 0;
}

void PinholeFiller::fill_in(std::span<const float> confidence) {
  const std::int64_t num_pixels = grid_.rows * grid_.cols;
  if (confidence.empty()) {
    confidence_.assign(num_pixels, 1.0F);
  } else {
    confidence_.assign(confidence.begin(), confidence.end());
  }
  points_.assign(grid_.points, grid_.points + 3 * num_pixels);
  valid_.assign(grid_.valid, grid_.valid + num_pixels);
  if (by_chance_) {
    interpolate_chance();
  } else {
    interpolate();
  }
  for (const std::int32_t p : filled_pixels_) {
    valid_[p] = 1;
    confidence_[p] = 0.0F;
  }
  filled_ = {grid_.rows, grid_.cols, points_.data(), valid_.data(), grid_.rows_up};
}

/// Tells measured pixels from those without a measurement.
void PinholeFiller::find_unseen(const StepRule& steps, const Surface& surface) {
  const std::int64_t num_pixels = grid_.rows * grid_.cols;
  state_.resize(num_pixels);
  // A local copy, because writes of bytes may alias members.
  std::uint8_t* const state = state_.data();
  const std::uint8_t* const valid = grid_.valid;
  for (std::int64_t p = 0; p < num_pixels; ++p) {
    state[p] = static_cast<std::uint8_t>(valid[p] != 0 ? kMeasured : kUnseen);
  }
  if (steps.has_steps()) find_strays(steps, surface);
  for (std::int64_t u = 0; u < grid_.cols; ++u) {
    for (const std::int64_t p : {u, num_pixels - grid_.cols + u}) {
      if (state_[p] == kUnseen) state_[p] = kOpen;
    }
  }
  for (std::int64_t v = 0; v < grid_.rows; ++v) {
    for (const std::int64_t p : {v * grid_.cols, (v + 1) * grid_.cols - 1}) {
      if (state_[p] == kUnseen) state_[p] = kOpen;
    }
  }
}

/// Opens the pixels without a measurement in and around squares of kChanceGap pixels a side without
/// one. The surroundings of the grid have none.
void PinholeFiller::open_gaps() {
  constexpr std::int64_t kPad = kChanceGap - 1;
  // The pixels right of a row are also those left of the next one.
  const std::int64_t cols = grid_.cols + kPad, size = (grid_.rows + 2 * kPad) * cols + kPad;
  const auto row_of = [&](std::int64_t v) { return (v + kPad) * cols + kPad; };
  gaps_.assign(size, 1);
  gaps_of_rows_.assign(size, 1);
  for (std::int64_t v = 0; v < grid_.rows; ++v) {
    const std::uint8_t* const states = &state_[v * grid_.cols];
    std::uint8_t* const unseen = &gaps_[row_of(v)];
    for (std::int64_t u = 0; u < grid_.cols; ++u) unseen[u] = states[u] == kMeasured ? 0 : 1;
  }
  std::uint8_t *const whole = gaps_.data(), *const rows = gaps_of_rows_.data();
  // The first pixel of each square, then all its pixels and those around it.
  const auto shrink = [size](const std::uint8_t* from, std::uint8_t* to, std::int64_t step) {
    for (std::int64_t p = 0; p < size - kPad * step; ++p) {
      std::uint8_t all = from[p];
      for (std::int64_t i = 1; i < kChanceGap; ++i) all &= from[p + i * step];
      to[p] = all;
    }
  };
  const auto grow = [size](const std::uint8_t* from, std::uint8_t* to, std::int64_t step) {
    for (std::int64_t p = kChanceGap * step; p < size - step; ++p) {
      std::uint8_t any = from[p + step];
      for (std::int64_t i = 0; i <= kChanceGap; ++i) any |= from[p - i * step];
      to[p] = any;
    }
  };
  shrink(whole, rows, 1);
  shrink(rows, whole, cols);
  grow(whole, rows, 1);
  grow(rows, whole, cols);
  for (std::int64_t v = 1; v + 1 < grid_.rows; ++v) {
    std::uint8_t* const states = &state_[v * grid_.cols];
    const std::uint8_t* const gaps = &whole[row_of(v)];
    for (std::int64_t u = 0; u < grid_.cols; ++u) {
      if (states[u] == kUnseen && gaps[u] != 0) states[u] = kOpen;
    }
  }
}

/// Finds the pixels without a measurement amid a surface, whatever the size and shape of their
/// holes: if many pixels are missing by chance, they are connected across the whole image. Large
/// holes are told by their width instead.
/// Without limits for surface triangles, nothing tells a narrow gap between two surfaces from a row
/// of missing pixels, and only lone pixels are evidence of chance.
/// @return  False if there are few of them. Only pinholes should be filled then.
bool PinholeFiller::find_chance(const StepRule& steps, double max_edge) {
  const auto are_few = [&](auto count) {
    const double enough = kChanceShare * static_cast<double>(state_.size());
    return static_cast<double>(count) < std::max(kChancePixels, enough);
  };
  const bool has_limits = steps.has_steps() || std::isfinite(max_edge);
  if (are_few(has_limits ? std::ranges::count(state_, kUnseen) : num_lone())) return false;
  open_gaps();
  filled_pixels_.clear();
  for (std::size_t p = 0; p < state_.size(); ++p) {
    if (state_[p] == kUnseen) filled_pixels_.push_back(static_cast<std::int32_t>(p));
  }
  if (are_few(filled_pixels_.size())) return false;
  std::erase_if(filled_pixels_,
                [&](std::int32_t p) { return !is_amid_surface(p, steps, max_edge); });
  if (are_few(filled_pixels_.size())) return false;
  for (std::uint8_t& state : state_) {
    if (state == kUnseen) state = kOpen;
  }
  for (const std::int32_t p : filled_pixels_) state_[p] = kFilled;
  num_filled_ = static_cast<std::int64_t>(filled_pixels_.size());
  return true;
}

/// The number of pixels without a measurement between four with one.
std::int64_t PinholeFiller::num_lone() const {
  const std::int64_t cols = grid_.cols;
  std::int64_t count = 0;
  for (std::int64_t p = cols; p < (grid_.rows - 1) * cols; ++p) {
    // Unseen pixels at the border are open.
    if (state_[p] != kUnseen) continue;
    count += (state_[p - cols] | state_[p - 1] | state_[p + 1] | state_[p + cols]) == kMeasured;
  }
  return count;
}

/// The measured points beside a pixel. If they are few, also those up to the reach of a hole that
/// is no gap; near a step in depth, these may be on another surface.
PinholeFiller::Around PinholeFiller::look_around(std::int32_t pixel) const {
  constexpr int kReach = kChanceGap / 2;
  const std::int64_t v = pixel / grid_.cols, u = pixel % grid_.cols;
  Around around;
  while (around.count < kEnough && around.reach < kReach) {
    around = {.reach = around.reach + 1};
    const std::int64_t left = std::max(std::int64_t{0}, u - around.reach);
    const std::int64_t right = std::min(grid_.cols - 1, u + around.reach);
    const std::int64_t first = std::max(std::int64_t{0}, v - around.reach);
    const std::int64_t last = std::min(grid_.rows - 1, v + around.reach);
    for (std::int64_t row = first * grid_.cols; row <= last * grid_.cols; row += grid_.cols) {
      for (std::int64_t p = row + left; p <= row + right; ++p) {
        if (state_[p] != kMeasured) continue;
        const Eigen::Array3f point = Point(grid_.points + 3 * p).array();
        around.low = around.low.min(point), around.high = around.high.max(point);
        around.sum += point;
        ++around.count;
      }
    }
  }
  return around;
}

/// Whether the measured pixels around a pixel are on one surface.
bool PinholeFiller::is_amid_surface(std::int32_t pixel, const StepRule& steps,
                                    double max_edge) const {
  const Around around = look_around(pixel);  // at least one point, because the pixel is in no gap
  const Eigen::Vector3d extent = (around.high - around.low).matrix().cast<double>();
  // The points lie in a square whose diagonal is 2 `reach` diagonals of a pixel's cell.
  const double limit = around.reach * max_edge;
  if (!(extent.norm() <= 2.0 * limit && extent.z() <= limit)) return false;
  return !steps.has_steps() || !steps.is_step(around.low.z(), around.high.z());
}

/// Finds pinholes; all other pixels without a measurement become open.
void PinholeFiller::find_pinholes(const StepRule& steps, double max_edge) {
  find_holes();
  open_.clear();
  for (Hole& hole : holes_) {
    if (is_amid_surface(hole, steps, max_edge)) continue;
    open_.insert(open_.end(), hole.pixels.begin(), hole.pixels.begin() + hole.size);
    for (int i = 0; i < hole.size; ++i) state_[hole.pixels[i]] = kOpen;
    hole.size = 0;
  }
  open_beside_open();
  num_filled_ = 0;
  for (const Hole& hole : holes_) num_filled_ += hole.size;
}

void PinholeFiller::find_holes() {
  const std::int64_t num_pixels = grid_.rows * grid_.cols;
  holes_.clear();
  hole_at_.resize(num_pixels);
  // A pixel beside an open one is open, because most pixels without a measurement are around an
  // object.
  for (std::int64_t p = grid_.cols + 1; p < num_pixels - grid_.cols; ++p) {
    if (p + 8 <= num_pixels && eight_bytes(&state_[p]) == 0) {  // all measured
      p += 7;
      continue;
    }
    if (state_[p] != kUnseen) continue;
    if (state_[p - 1] == kOpen || state_[p - grid_.cols] == kOpen) {
      state_[p] = kOpen;
    } else {
      gather(static_cast<std::int32_t>(p));
    }
  }
}

/// Finds measurements with steps all around them. They are on no surface and count as missing.
void PinholeFiller::find_strays(const StepRule& steps, const Surface& surface) {
  used_.resize(grid_.cols);
  for (std::int64_t v = 1; v + 1 < grid_.rows; ++v) {
    surface.uses_of_row(v, used_);
    for (std::int64_t u = 1; u + 1 < grid_.cols; ++u) {
      const std::int64_t p = v * grid_.cols + u;
      if (u + 8 <= grid_.cols && (eight_bytes(grid_.valid + p) & ~eight_bytes(&used_[u])) == 0) {
        u += 7;  // all measured pixels are used
        continue;
      }
      if (grid_.valid[p] == 0 || used_[u] != 0) continue;
      const float depth = grid_.points[3 * p + 2];
      bool is_stray = true;
      const auto look = [&](std::int64_t other) {
        if (grid_.valid[other] == 0) return;
        const float beside = grid_.points[3 * other + 2];
        is_stray = steps.is_step(std::min(depth, beside), std::max(depth, beside));
      };
      for (const std::int64_t row : {-grid_.cols, std::int64_t{0}, grid_.cols}) {
        for (const std::int64_t column : {-1, 0, 1}) {
          if (is_stray && (row != 0 || column != 0)) look(p + row + column);
        }
      }
      if (is_stray) state_[p] = kUnseen;
    }
  }
}

/// Gathers the pixels connected to the first one by sides: a hole, or open if they are too many or
/// touch an open pixel.
void PinholeFiller::gather(std::int32_t first) {
  Hole hole;
  hole.pixels[hole.size++] = first;
  state_[first] = kFilled;
  bool is_open = false;
  for (int i = 0; i < hole.size && !is_open; ++i) {
    for (const std::int64_t step : {-grid_.cols, std::int64_t{-1}, std::int64_t{1}, grid_.cols}) {
      const std::int64_t next = hole.pixels[i] + step;
      if (state_[next] == kOpen || (state_[next] == kUnseen && hole.size == kPinhole)) {
        is_open = true;
        break;
      }
      if (state_[next] != kUnseen) continue;
      state_[next] = kFilled;
      hole.pixels[hole.size++] = static_cast<std::int32_t>(next);
    }
  }
  for (int i = 0; i < hole.size; ++i) {
    if (is_open) state_[hole.pixels[i]] = kOpen;
    hole_at_[hole.pixels[i]] = static_cast<std::int32_t>(holes_.size());
  }
  if (!is_open) holes_.push_back(hole);
}

bool PinholeFiller::is_amid_surface(const Hole& hole, const StepRule& steps,
                                    double max_edge) const {
  Eigen::Array3f low = Eigen::Array3f::Constant(kInfinityF), high = -low;
  bool is_amid = true;
  for (int i = 0; i < hole.size; ++i) {
    visit_around(hole.pixels[i], [&](std::int64_t p) {
      if (state_[p] == kOpen) is_amid = false;
      if (state_[p] != kMeasured) return;
      const Eigen::Array3f point = Point(grid_.points + 3 * p).array();
      low = low.min(point), high = high.max(point);
    });
  }
  if (!is_amid || ((high - low).matrix().cast<double>().norm() > max_edge)) return false;
  return !steps.has_steps() || !steps.is_step(low.z(), high.z());
}

/// Opens holes beside open ones, which are at the end of a surface, and then those beside these.
void PinholeFiller::open_beside_open() {
  while (!open_.empty()) {
    const std::int64_t from = open_.back();
    open_.pop_back();
    visit_around(from, [&](std::int64_t p) {
      if (state_[p] != kFilled) return;
      Hole& hole = holes_[hole_at_[p]];
      for (int i = 0; i < hole.size; ++i) {
        state_[hole.pixels[i]] = kOpen;
        open_.push_back(hole.pixels[i]);
      }
      hole.size = 0;
    });
  }
}

void PinholeFiller::interpolate() {
  filled_pixels_.clear();
  for (const Hole& hole : holes_) {
    interpolate(hole);
    filled_pixels_.insert(filled_pixels_.end(), hole.pixels.begin(),
                          hole.pixels.begin() + hole.size);
  }
}

/// Gauss-Seidel iteration that starts from the mean of the measured neighbours; planes stay planes.
void PinholeFiller::interpolate(const Hole& hole) {
  constexpr int kMeasuredOne = -1;
  const std::array<std::int64_t, 4> steps = {-grid_.cols, -1, 1, grid_.cols};
  const auto at = [this](std::int64_t p) { return Point(grid_.points + 3 * p).cast<double>(); };
  std::array<std::array<int, 4>, kPinhole> beside{};  // index in the hole, or kMeasuredOne
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  int count = 0;
  for (int i = 0; i < hole.size; ++i) {
    for (std::size_t k = 0; k < 4; ++k) {
      const std::int64_t p = hole.pixels[i] + steps[k];
      const auto end = hole.pixels.begin() + hole.size;
      const auto own = std::find(hole.pixels.begin(), end, p);
      beside[i][k] = own == end ? kMeasuredOne : static_cast<int>(own - hole.pixels.begin());
      if (own != end) continue;
      mean += at(p);
      ++count;
    }
  }
  std::array<Eigen::Vector3d, kPinhole> points;
  std::fill_n(points.begin(), hole.size, Eigen::Vector3d(mean / std::max(1, count)));
  for (int round = 0; round < (hole.size > 1 ? kRounds : 1); ++round) {
    for (int i = 0; i < hole.size; ++i) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (std::size_t k = 0; k < 4; ++k) {
        const int own = beside[i][k];
        sum += own == kMeasuredOne ? at(hole.pixels[i] + steps[k]) : points[own];
      }
      points[i] = 0.25 * sum;
    }
  }
  for (int i = 0; i < hole.size; ++i) {
    const std::int64_t p = hole.pixels[i];
    for (int axis = 0; axis < 3; ++axis)
      points_[3 * p + axis] = static_cast<float>(points[i][axis]);
  }
}

/// The same for all filled pixels at once, each from the mean of the measured points around it.
/// Open neighbours do not count.
void PinholeFiller::interpolate_chance() {
  const auto at = [this](std::int64_t p) { return Eigen::Map<Vec3>(&points_[3 * p]); };
  for (const std::int32_t p : filled_pixels_) {
    const Around around = look_around(p);
    at(p) = around.sum / static_cast<float>(around.count);
  }
  for (int round = 0; round < kRounds; ++round) {
    for (const std::int64_t p : filled_pixels_) {
      Vec3 sum = Vec3::Zero();
      int count = 0;
      for (const std::int64_t q : {p - grid_.cols, p - 1, p + 1, p + grid_.cols}) {
        if (state_[q] != kOpen) sum += at(q), ++count;
      }
      if (count > 0) at(p) = sum / static_cast<float>(count);
    }
  }
}

}  // namespace manip3d::relief_detail
