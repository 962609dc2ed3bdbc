#include "manip3d/simplify/depth_smoother.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <string>

#include "geometry/constants.hpp"
#include "geometry/median.hpp"
#include "geometry/wide_vectors.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/depth_step.hpp"
#include "simplify/relief/raster.hpp"

namespace manip3d {
namespace {

// Multiples of the standard deviation of the noise. Of about 40 choices, tried on five recordings
// of people (UTD-MHAD, actions 1, 4, 6, 8 and 12 of the first subject), these halve the flicker
// with the smallest error of moving parts.
constexpr float kMotion = 3.0F;  // a mean change below it is noise, above twice that it is motion
constexpr float kNewSurface = 4.0F;  // a pixel shows another surface, apart from motion
// The mean of a pair of pixels is on the same surface as the pixel between them.
constexpr float kSameSurface = 4.0F;
constexpr float kNearShown = 3.0F;  // the mesh that was shown last agrees with the depth
constexpr double kMaxNoise = 2.0;   // relative to a Kinect's
constexpr int kRadius = 2;          // pixels, of the neighbourhood of a pixel
constexpr int kAround = (2 * kRadius + 1) * (2 * kRadius + 1);  // pixels, including itself
constexpr std::int64_t kBlock = 8;  // pixels a side; three blocks are at least as wide as an arm
constexpr float kPixelsAround = 9.0F * kBlock * kBlock;  // of a block and the blocks around it
constexpr std::size_t kMinSamples = 20;
constexpr std::int64_t kLargestSide = 16384;
constexpr std::uint16_t kMaxFrames = 60000;

bool is_measured(float depth) { return depth > 0.0F && depth < kInfinityF; }

MANIP3D_INLINE float noise_at(float depth) {
  constexpr auto kAtOneMetre = static_cast<float>(DepthStepOptions{}.noise_at_1_m);
  return kAtOneMetre * depth * depth;
}

/// The part of a mean change that is motion: 0 up to the limit, 1 from twice that on.
MANIP3D_INLINE float part_of_motion(float change, float limit) {
  const float above = std::abs(change) - limit;
  return above <= 0.0F ? 0.0F : above >= limit ? 1.0F : above / limit;
}

/// Moves a measured noise towards the value from the newest frame; a negative noise is unknown.
void renew(double& noise, double now, double share) {
  noise = noise < 0.0 ? now : noise + share * (now - noise);
}

/// The standard deviation, relative to a Kinect's, of a quantity with these second differences over
/// time.
double deviation_of(std::vector<float>& differences, double most) {
  return std::min(kNormalMad / std::sqrt(6.0) * median(std::span(differences)), most);
}

/// Adds to each number of a row its neighbours up to kRadius before and after it.
void add_beside(const float* in, std::int64_t size, float* out) {
  std::copy_n(in, size, out);
  for (std::int64_t k = 1; k <= std::min<std::int64_t>(kRadius, size - 1); ++k) {
    for (std::int64_t i = k; i < size; ++i) out[i] += in[i - k];
    for (std::int64_t i = 0; i < size - k; ++i) out[i] += in[i + k];
  }
}

/// A row of pixels, and the pixels at two opposite offsets from them.
struct Pair {
  const float *row, *before, *after;
  float slope;  ///< Largest allowed difference of the two, as a share of the depth between them.
};

/// Adds the pairs that lie on the surface of the pixel between them. `noise` is the allowed
/// distance of their mean from it, in units of noise_at().
MANIP3D_INLINE void add_pairs_of(const Pair& pair, std::int64_t first, std::int64_t end,
                                 float noise, float* sum, float* number) {
  const float *row = pair.row, *before = pair.before, *after = pair.after;
  const float slope = pair.slope;
  for (std::int64_t u = first; u < end; ++u) {
    const float z = row[u], a = after[u], b = before[u], both = a + b;
    const int is_same = int{a > 0.0F} & int{b > 0.0F} & int{std::abs(a - b) <= slope * z} &
                        int{std::abs(0.5F * both - z) <= noise * noise_at(z)};
    sum[u] += is_same != 0 ? both : 0.0F;
    number[u] += is_same != 0 ? 2.0F : 0.0F;
  }
}

void add_pairs(const Pair& pair, std::int64_t first, std::int64_t end, float noise, float* sum,
               float* number) {
  add_pairs_of(pair, first, end, noise, sum, number);
}

#ifdef MANIP3D_AVX2
MANIP3D_AVX2 void add_pairs_wide(const Pair& pair, std::int64_t first, std::int64_t end,
                                 float noise, float* sum, float* number) {
  add_pairs_of(pair, first, end, noise, sum, number);
}
#endif

}  // namespace

DepthSmoother::DepthSmoother(const DepthSmootherOptions& options) : options_(options) {
  if (!(options.newest_share > 0.0 && options.newest_share <= 1.0)) {
    throw InputError("newest_share: expected in (0, 1], got " + number_text(options.newest_share));
  }
  if (!(options.gate > 0.0)) {
    throw InputError("gate: expected > 0, got " + number_text(options.gate));
  }
}

void DepthSmoother::reset() {
  mean_.clear();
  last_.clear();
  second_last_.clear();
  has_shown_ = false;
  starts_anew_ = true;
  noise_ = noise_of_means_ = noise_of_blocks_ = -1.0;
}

const std::vector<float>& DepthSmoother::add(const DepthView& depth) {
  const std::size_t size = depth.rows * depth.cols;
  const bool is_first = mean_.size() != size || rows_ != depth.rows || cols_ != depth.cols;
  if (is_first) {
    reset();
    rows_ = depth.rows;
    cols_ = depth.cols;
    mean_.assign(size, 0.0F);
    count_.assign(size, 0);
  }
  take(depth);
  starts_anew_ = is_first;
  if (box_.u < box_.end_u) find_changes();
  if (options_.newest_share == 1.0) {
    remember();
  } else if (box_.u < box_.end_u) {
    find_motion();
    measure_noise();
    measure_noise_of_means();
    measure_noise_of_blocks();
    second_last_.swap(last_);
    last_ = out_;
    find_block_motion();
    update();
    smooth_surface();
    if (has_shown_ && !starts_anew_) {
      find_moving_blocks();
      stay_near_shown();
    }
  }
  has_shown_ = false;
  return out_;
}

template <typename Visit>
void DepthSmoother::for_each_row(Visit&& visit) const {
  for (std::int64_t v = box_.v; v < box_.end_v; ++v) {
    visit((v - box_.v) * (box_.end_u - box_.u), v * cols_ + box_.u);
  }
}

void DepthSmoother::take(const DepthView& depth) {
  out_.resize(mean_.size());
  box_ = {cols_, rows_, 0, 0};
  for (std::int64_t v = 0; v < rows_; ++v) {
    std::int64_t first = cols_, end = 0;
    for (std::int64_t u = 0; u < cols_; ++u) {
      const float z = depth.at(v * cols_ + u);
      // NaN and -0 become 0; negative and infinite depths stay, and count as not measured.
      out_[v * cols_ + u] = z > 0.0F || z < 0.0F ? z : 0.0F;
      if (!is_measured(z)) continue;
      first = std::min(first, u);
      end = u + 1;
    }
    if (end == 0) continue;
    box_ = {std::min(box_.u, first), std::min(box_.v, v), std::max(box_.end_u, end), v + 1};
  }
}

void DepthSmoother::find_changes() {
  const std::int64_t width = box_.end_u - box_.u;
  for (auto* by_pixel :
       {&change_, &goes_on_, &motion_, &moves_, &drift_, &sums_, &numbers_, &current_}) {
    by_pixel->resize(width * (box_.end_v - box_.v));
  }
  row_.resize(2 * width);
  const auto gate = static_cast<float>(options_.gate);
  std::int64_t num_measured = 0, num_going_on = 0;
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    for (std::int64_t u = 0; u < width; ++u) {
      const float z = out_[in_image + u], mean = mean_[in_image + u], change = z - mean;
      const bool goes_on =
          is_measured(z) && count_[in_image + u] > 0 && std::abs(change) <= gate * mean;
      change_[in_box + u] = goes_on ? change : 0.0F;
      goes_on_[in_box + u] = goes_on ? 1.0F : 0.0F;
      num_measured += int{is_measured(z)};
      num_going_on += int{goes_on};
    }
  });
  starts_anew_ = 2 * num_going_on < num_measured;
  if (!starts_anew_) return;
  // The camera sees another view: even pixels whose depth is nearly the same show another surface.
  std::ranges::fill(change_, 0.0F);
  std::ranges::fill(goes_on_, 0.0F);
  std::ranges::fill(count_, std::uint16_t{0});
  last_.clear();
  second_last_.clear();
}

void DepthSmoother::remember() {
  for (std::size_t i = 0; i < out_.size(); ++i) {
    if (!is_measured(out_[i])) continue;
    mean_[i] = out_[i];
    count_[i] = 1;
  }
}

void DepthSmoother::find_motion() {
  const std::int64_t width = box_.end_u - box_.u, height = box_.end_v - box_.v;
  for (std::int64_t v = 0; v < height; ++v) {
    add_beside(change_.data() + v * width, width, sums_.data() + v * width);
    add_beside(goes_on_.data() + v * width, width, numbers_.data() + v * width);
  }
  float* const sum = row_.data();
  float* const number = sum + width;
  for (std::int64_t v = 0; v < height; ++v) {
    std::fill(row_.begin(), row_.end(), 0.0F);
    for (std::int64_t w = std::max<std::int64_t>(v - kRadius, 0);
         w <= std::min(v + kRadius, height - 1); ++w) {
      for (std::int64_t u = 0; u < width; ++u) sum[u] += sums_[w * width + u];
      for (std::int64_t u = 0; u < width; ++u) number[u] += numbers_[w * width + u];
    }
    float* const motion = motion_.data() + v * width;
    for (std::int64_t u = 0; u < width; ++u) {
      motion[u] = goes_on_[v * width + u] * sum[u] / std::max(number[u], 1.0F);
    }
  }
}

void DepthSmoother::measure_noise() {
  constexpr std::int64_t kStride = 4;  // rows; a quarter of the pixels is enough
  // Limit of a pixel's ratio, because moving pixels are not all recognized.
  constexpr float kMost = 3.0F;
  // Standard deviation over mean absolute value of a normal distribution.
  constexpr double kDeviationOverMean = 1.25;
  const auto share = static_cast<float>(options_.newest_share);
  const std::int64_t width = box_.end_u - box_.u;
  double sum = 0.0;
  std::int64_t number = 0;
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    if (in_box / width % kStride != 0) return;
    for (std::int64_t u = 0; u < width; ++u) {
      if (goes_on_[in_box + u] == 0.0F) continue;
      // The variance of the recursive mean, relative to that of a single depth.
      const float before = std::max(share, 1.0F / static_cast<float>(count_[in_image + u]));
      const float relative =
          std::abs(change_[in_box + u] - motion_[in_box + u]) / noise_at(mean_[in_image + u]);
      sum += (relative < kMost ? relative : kMost) / std::sqrt(1.0F + before);
      ++number;
    }
  });
  if (number == 0) return;
  const double now = std::min(kDeviationOverMean * sum / static_cast<double>(number), kMaxNoise);
  renew(noise_, now, options_.newest_share);
}

/// Uses second differences over time, which vanish for motion at a constant speed; their median is
/// hardly raised by moving edges.
void DepthSmoother::measure_noise_of_means() {
  // Distances of samples; a sixteenth of the pixels is enough.
  constexpr std::int64_t kRows = 8, kCols = 2;
  if (second_last_.size() != out_.size()) return;
  samples_.clear();
  for (std::int64_t v = box_.v + kRadius; v < box_.end_v - kRadius; v += kRows) {
    for (std::int64_t u = box_.u + kRadius; u < box_.end_u - kRadius; u += kCols) {
      add_second_difference(v * cols_ + u);
    }
  }
  if (samples_.size() < kMinSamples) return;
  renew(noise_of_means_, deviation_of(samples_, kMaxNoise), options_.newest_share);
}

void DepthSmoother::add_second_difference(std::int64_t pixel) {
  const auto gate = static_cast<float>(options_.gate);
  float sum = 0.0F;
  for (int dv = -kRadius; dv <= kRadius; ++dv) {
    for (int du = -kRadius; du <= kRadius; ++du) {
      const std::int64_t i = pixel + dv * cols_ + du;
      const float now = out_[i], then = last_[i], before = second_last_[i];
      if (!(is_measured(now) && is_measured(then) && is_measured(before))) return;
      if (!(std::abs(now - then) <= gate * then && std::abs(then - before) <= gate * then)) return;
      sum += (now - then) - (then - before);
    }
  }
  const float mean = std::abs(sum) / static_cast<float>(kAround) / noise_at(last_[pixel]);
  if (mean < kInfinityF) samples_.push_back(mean);
}

void DepthSmoother::measure_noise_of_blocks() {
  constexpr float kMeasured = 0.75F;  // share of the surrounding pixels
  if (second_last_.size() != out_.size()) return;
  const auto gate = static_cast<float>(options_.gate);
  clear_block_sums();
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    const float *now = out_.data() + in_image, *then = last_.data() + in_image,
                *before = second_last_.data() + in_image;
    add_to_blocks(in_box, [&](std::int64_t u) {
      const float newest = now[u] - then[u], last = then[u] - before[u], limit = gate * then[u];
      const int counts = int{is_measured(now[u])} & int{is_measured(before[u])} &
                         int{is_measured(then[u])} & int{std::abs(newest) <= limit} &
                         int{std::abs(last) <= limit};
      return BlockSum{counts != 0 ? newest - last : 0.0F, counts != 0 ? then[u] : 0.0F,
                      static_cast<float>(counts)};
    });
  });
  samples_.clear();
  for (std::int64_t v = 0; v < block_rows_; ++v) {
    for (std::int64_t u = 0; u < block_cols_; ++u) {
      const BlockSum all = sum_around(v, u);
      if (all.number < kMeasured * kPixelsAround) continue;
      const float mean = std::abs(all.value) / all.number / noise_at(all.depth / all.number);
      if (mean < kInfinityF) samples_.push_back(mean);
    }
  }
  if (samples_.size() < kMinSamples) return;
  renew(noise_of_blocks_, deviation_of(samples_, kMaxNoise), options_.newest_share);
}

void DepthSmoother::clear_block_sums() {
  block_cols_ = (box_.end_u - box_.u + kBlock - 1) / kBlock;
  block_rows_ = (box_.end_v - box_.v + kBlock - 1) / kBlock;
  block_sums_.assign(block_cols_ * block_rows_, {});
}

template <typename Value>
void DepthSmoother::add_to_blocks(std::int64_t in_box, Value&& value) {
  const std::int64_t width = box_.end_u - box_.u;
  BlockSum* const row = block_sums_.data() + in_box / width / kBlock * block_cols_;
  for (std::int64_t block = 0; block < block_cols_; ++block) {
    BlockSum sum = row[block];
    for (std::int64_t u = block * kBlock; u < std::min((block + 1) * kBlock, width); ++u) {
      const BlockSum one = value(u);
      sum.value += one.value;
      sum.depth += one.depth;
      sum.number += one.number;
    }
    row[block] = sum;
  }
}

DepthSmoother::BlockSum DepthSmoother::sum_around(std::int64_t v, std::int64_t u) const {
  BlockSum all;
  for (std::int64_t y = std::max<std::int64_t>(v - 1, 0); y <= std::min(v + 1, block_rows_ - 1);
       ++y) {
    for (std::int64_t x = std::max<std::int64_t>(u - 1, 0); x <= std::min(u + 1, block_cols_ - 1);
         ++x) {
      const BlockSum& one = block_sums_[y * block_cols_ + x];
      all.value += one.value;
      all.depth += one.depth;
      all.number += one.number;
    }
  }
  return all;
}

float DepthSmoother::limit_of_motion() const {
  // While it is unknown, assume that the noise of different pixels is independent.
  const double noise =
      noise_of_means_ < 0.0 ? std::max(noise_, 0.0) / (2 * kRadius + 1) : noise_of_means_;
  return kMotion * static_cast<float>(noise);
}

void DepthSmoother::find_block_motion() {
  const auto noise = kNewSurface * static_cast<float>(std::max(noise_, 0.0));
  const float limit = limit_of_motion();
  clear_block_sums();
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    add_to_blocks(in_box, [&](std::int64_t u) {
      const std::int64_t i = in_box + u;
      const float mean = mean_[in_image + u], sigma = noise_at(mean), change = change_[i];
      moves_[i] = part_of_motion(motion_[i], limit * sigma);
      const bool counts = goes_on_[i] != 0.0F && std::abs(change) <= noise * sigma;
      const float weight = counts ? 1.0F - moves_[i] : 0.0F;
      return BlockSum{weight * change, counts ? weight * mean : 0.0F, weight};
    });
  });
  block_motion_.assign(block_cols_ * block_rows_, 0.0F);
  if (noise_of_blocks_ < 0.0) return;
  for (std::int64_t v = 0; v < block_rows_; ++v) {
    for (std::int64_t u = 0; u < block_cols_; ++u) {
      const BlockSum all = sum_around(v, u);
      if (!(all.number >= 1.0F)) continue;
      const float mean = all.value / all.number;
      const float sigma = static_cast<float>(noise_of_blocks_) *
                          std::sqrt(kPixelsAround / all.number) * noise_at(all.depth / all.number);
      const float followed = part_of_motion(mean, kMotion * sigma) * mean;
      if (std::abs(followed) < kInfinityF) block_motion_[v * block_cols_ + u] = followed;
    }
  }
}

void DepthSmoother::interpolate_block_motion(std::int64_t v, float* drift) const {
  const std::int64_t width = box_.end_u - box_.u, half = kBlock / 2;
  const auto at = [](std::int64_t i) { return (static_cast<float>(i) + 0.5F) / kBlock; };
  const std::int64_t below = (v + half) / kBlock;  // index of the lower of the two rows of blocks
  const float* const first =
      block_motion_.data() + std::max<std::int64_t>(below - 1, 0) * block_cols_;
  const float* const second = block_motion_.data() + std::min(below, block_rows_ - 1) * block_cols_;
  const float down = at((v + half) % kBlock);
  for (std::int64_t right = 0; right <= block_cols_; ++right) {
    const std::int64_t a = std::max<std::int64_t>(right - 1, 0);
    const std::int64_t b = std::min(right, block_cols_ - 1);
    const float before = first[a] + down * (second[a] - first[a]);
    const float after = first[b] + down * (second[b] - first[b]);
    const std::int64_t start = right * kBlock - half;
    for (std::int64_t u = std::max<std::int64_t>(start, 0); u < std::min(start + kBlock, width);
         ++u) {
      drift[u] = before + at(u - start) * (after - before);
    }
  }
}

void DepthSmoother::update() {
  const auto share = static_cast<float>(options_.newest_share);
  const auto noise = static_cast<float>(std::max(noise_, 0.0));
  const float limit = limit_of_motion();
  const std::int64_t width = box_.end_u - box_.u;
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    interpolate_block_motion(in_box / width, drift_.data() + in_box);
    for (std::int64_t u = 0; u < width; ++u) {
      const std::int64_t i = in_box + u;
      const float z = out_[in_image + u];
      current_[i] = 0.0F;
      if (!is_measured(z)) continue;  // a pixel that returns soon continues from its old mean
      float& mean = mean_[in_image + u];
      std::uint16_t& count = count_[in_image + u];
      const float sigma = noise_at(mean), drift = drift_[i], own = motion_[i] - drift;
      const float followed = drift + part_of_motion(own, limit * sigma) * own;
      const float rest = change_[i] - followed;
      const bool goes_on = goes_on_[i] != 0.0F && std::abs(rest) <= kNewSurface * noise * sigma;
      count = goes_on ? static_cast<std::uint16_t>(std::min<int>(count + 1, kMaxFrames))
                      : std::uint16_t{1};
      if (!goes_on) moves_[i] = 1.0F;
      const float weight = std::max(share, 1.0F / static_cast<float>(count));
      current_[i] = mean = goes_on ? mean + followed + weight * rest : z;
    }
  });
}

void DepthSmoother::smooth_surface() {
  const auto noise = kSameSurface * static_cast<float>(std::max(noise_, 0.0));
  const auto gate = static_cast<float>(options_.gate);
  const std::int64_t width = box_.end_u - box_.u, height = box_.end_v - box_.v;
  auto* add = &add_pairs;
#ifdef MANIP3D_AVX2
  if (has_avx2()) add = &add_pairs_wide;
#endif
  float* const sum = row_.data();
  float* const number = sum + width;
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    const std::int64_t v = in_box / width;
    const float* const row = current_.data() + in_box;
    std::copy_n(row, width, sum);
    std::fill_n(number, width, 1.0F);
    const std::int64_t most =
        noise > 0.0F ? std::min({std::int64_t{kRadius}, v, height - 1 - v}) : -1;
    for (std::int64_t dv = 0; dv <= most; ++dv) {
      for (std::int64_t du = dv == 0 ? 1 : -kRadius; du <= kRadius; ++du) {
        const auto length = std::sqrt(static_cast<float>(du * du + dv * dv));
        const std::int64_t away = dv * width + du, margin = std::abs(du);
        add({row, row - away, row + away, gate * length}, margin, width - margin, noise, sum,
            number);
      }
    }
    for (std::int64_t u = 0; u < width; ++u) {
      if (!(row[u] > 0.0F)) continue;
      const float mean = sum[u] / number[u];
      out_[in_image + u] = mean < kInfinityF ? mean : row[u];
    }
  });
}

void DepthSmoother::find_moving_blocks() {
  clear_block_sums();
  for_each_row([&](std::int64_t in_box, std::int64_t) {
    add_to_blocks(in_box, [&](std::int64_t u) {
      const float goes_on = goes_on_[in_box + u];
      return BlockSum{goes_on * moves_[in_box + u], 0.0F, goes_on};
    });
  });
  moving_blocks_.resize(block_sums_.size());
  for (std::int64_t v = 0; v < block_rows_; ++v) {
    for (std::int64_t u = 0; u < block_cols_; ++u) {
      const BlockSum all = sum_around(v, u);
      moving_blocks_[v * block_cols_ + u] = all.value / std::max(all.number, 1.0F);
    }
  }
}

void DepthSmoother::stay_near_shown() {
  // Shown depths follow the motion of the blocks, so they may approach new depths more slowly.
  const auto share = 0.5F * static_cast<float>(options_.newest_share);
  const auto noise = kNearShown * static_cast<float>(std::max(noise_, 0.0));
  const std::int64_t width = box_.end_u - box_.u;
  for_each_row([&](std::int64_t in_box, std::int64_t in_image) {
    const float* const moving = moving_blocks_.data() + in_box / width / kBlock * block_cols_;
    for (std::int64_t u = 0; u < width; ++u) {
      float& depth = out_[in_image + u];
      if (!(shown_[in_image + u] > 0.0F) || !is_measured(depth)) continue;
      const float shown = shown_[in_image + u] + drift_[in_box + u] * goes_on_[in_box + u];
      const float from = depth - shown, limit = noise * noise_at(depth);
      const float by_motion = 4.0F * moving[u / kBlock] * moving[u / kBlock];
      const auto count = static_cast<float>(count_[in_image + u]);
      // (2 moving)^4 is 1 from half of the pixels on: the mesh shown last is then ignored.
      const float least = std::max({by_motion * by_motion, share, 1.0F / count});
      const float squared = from * from, most = limit * limit;
      const float part = squared >= most ? 1.0F : std::clamp(squared / most, least, 1.0F);
      depth = shown + part * from;
    }
  });
}

void DepthSmoother::show(const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                         std::span<const float> depths,
                         const Eigen::Ref<const Rows<std::int32_t, 3>>& faces) {
  const auto num_vertices = static_cast<std::int64_t>(pixels.rows());
  if (num_vertices != static_cast<std::int64_t>(depths.size())) {
    throw InputError("depths: expected " + std::to_string(num_vertices) + " numbers, got " +
                     std::to_string(depths.size()));
  }
  if (rows_ > kLargestSide || cols_ > kLargestSide) {
    throw InputError("depth: expected at most 16384 pixels a side, got " + std::to_string(cols_) +
                     " x " + std::to_string(rows_));
  }
  for (std::int64_t i = 0; i < num_vertices; ++i) {
    if (mean_.empty() || pixels(i, 0) < 0 || pixels(i, 0) >= cols_ || pixels(i, 1) < 0 ||
        pixels(i, 1) >= rows_) {
      throw InputError("pixels: expected those of the last frame, got (" +
                       std::to_string(pixels(i, 0)) + ", " + std::to_string(pixels(i, 1)) + ")");
    }
  }
  for (const std::int32_t vertex : faces.reshaped()) {
    if (vertex < 0 || vertex >= num_vertices) {
      throw InputError("faces: index out of range: " + std::to_string(vertex));
    }
  }
  if (options_.newest_share == 1.0) return;
  shown_.assign(mean_.size(), 0.0F);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    std::array<std::array<std::int32_t, 2>, 3> at{};
    std::array<float, 3> inverse{};
    for (int i = 0; i < 3; ++i) {
      const std::int32_t vertex = faces(f, i);
      at[i] = {pixels(vertex, 0), pixels(vertex, 1)};
      inverse[i] = depths[vertex] > 0.0F ? 1.0F / depths[vertex] : 0.0F;
    }
    draw(at, inverse);
  }
  has_shown_ = true;
}

/// Interpolates the inverse of the depth, which is linear over the image of a plane.
void DepthSmoother::draw(std::array<std::array<std::int32_t, 2>, 3> at,
                         std::array<float, 3> inverse) {
  std::int64_t area = relief_detail::doubled_area(at[0], at[1], at[2]);
  if (area == 0 || !(std::ranges::min(inverse) > 0.0F)) return;
  if (area < 0) {
    std::swap(at[1], at[2]);
    std::swap(inverse[1], inverse[2]);
    area = -area;
  }
  const auto scale = 1.0F / static_cast<float>(area);
  const float d1 = inverse[1] - inverse[0], d2 = inverse[2] - inverse[0];
  const auto u1 = static_cast<float>(at[1][0] - at[0][0]),
             v1 = static_cast<float>(at[1][1] - at[0][1]);
  const auto u2 = static_cast<float>(at[2][0] - at[0][0]),
             v2 = static_cast<float>(at[2][1] - at[0][1]);
  const float along_u = scale * (d1 * v2 - d2 * v1), along_v = scale * (d2 * u1 - d1 * u2);
  const auto cols = static_cast<std::int32_t>(cols_);
  relief_detail::visit_spans(
      cols, at[0], at[1], at[2], relief_detail::SidePixels::kClosed,
      [&](std::int32_t first, std::int32_t last) {
        const std::int32_t v = first / cols, u = first - v * cols;
        const float start = inverse[0] + along_v * static_cast<float>(v - at[0][1]);
        for (std::int32_t i = 0; i <= last - first; ++i) {
          shown_[first + i] = 1.0F / (start + along_u * static_cast<float>(u + i - at[0][0]));
        }
      });
}

}  // namespace manip3d
