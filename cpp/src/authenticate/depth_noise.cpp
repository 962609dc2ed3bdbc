#include "manip3d/authenticate/depth_noise.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "geometry/union_find.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/depth_step.hpp"

namespace manip3d {
namespace {

constexpr std::int64_t kWindowReach = 2;  // pixels on each side of the middle one
constexpr std::int64_t kWindow = 2 * kWindowReach + 1;
constexpr int kMinSpanWidth = 8;  // pixels; narrower spans are left out

void check_millimetres(const DepthView& depth) {
  if (depth.millimetres == nullptr || depth.rows == 0 || depth.cols == 0) {
    throw InputError("depth: expected pixels in millimetres (uint16)");
  }
}

std::array<double, kWindow> gaussian(double sigma) {
  std::array<double, kWindow> weights{};
  double sum = 0.0;
  for (int i = -kWindowReach; i <= kWindowReach; ++i) {
    weights[i + kWindowReach] = std::exp(-0.5 * i * i / (sigma * sigma));
    sum += weights[i + kWindowReach];
  }
  for (double& w : weights) w /= sum;
  return weights;
}

/// The image index at i, mirrored at both borders: ... 1 0 | 0 1 2 ... n-1 | n-1 n-2 ...
std::int64_t mirrored(std::int64_t i, std::int64_t size) {
  if (i < 0) i = -1 - i;
  if (i >= size) i = 2 * size - 1 - i;
  return std::clamp<std::int64_t>(i, 0, size - 1);
}

/// Finds the silhouette spans of one image row.
class RowScanner {
 public:
  RowScanner(const DepthView& depth, const DepthStep& step, double min_relief,
             std::vector<SilhouetteSpan>& spans, std::vector<float>& span_depth)
      : depth_(depth),
        step_(step),
        min_relief_(static_cast<float>(min_relief)),
        spans_(spans),
        span_depth_(span_depth) {}

  void scan(std::int64_t v) {
    column_.clear();
    z_.clear();
    for (std::int64_t u = 0; u < depth_.cols; ++u) {
      const std::uint16_t mm = depth_.millimetres[v * depth_.cols + u];
      if (mm == 0) continue;
      column_.push_back(static_cast<std::int32_t>(u));
      z_.push_back(static_cast<float>(mm) / 1000.0F);
    }
    open_.clear();
    for (std::size_t i = 1; i < z_.size(); ++i) {
      if (joined(i - 1, i)) continue;
      if (z_[i] < z_[i - 1]) {
        // A single pixel that is nearer than both neighbours is noise.
        if (i + 1 < z_.size() && !step_.connects(z_[i + 1], z_[i - 1])) open_.push_back(i);
      } else {
        close(v, i);
      }
    }
  }

 private:
  /// Do two successive measured pixels lie on one surface?
  [[nodiscard]] bool joined(std::size_t i, std::size_t j) const {
    const auto [near, far] = std::minmax(z_[i], z_[j]);
    constexpr std::int32_t kFarthest = 3;  // pixels: a slope is continued at most over this gap
    const auto way = static_cast<float>(std::min(column_[j] - column_[i], kFarthest));
    return step_.connects(near, near + (far - near) / way);
  }

  /// Closes all open spans that end at the step from pixel i - 1 to the farther pixel i: those
  /// whose surroundings are not farther than pixel i. Adds the outermost of them.
  void close(std::int64_t v, std::size_t i) {
    std::size_t begin = 0;
    while (!open_.empty()) {
      const float level = z_[open_.back() - 1];
      if (z_[i] < level && !step_.connects(z_[i], level)) break;
      begin = open_.back();  // of spans that end together, the outermost one is kept
      open_.pop_back();
    }
    if (begin == 0) return;
    const std::int32_t left = column_[begin], right = column_[i - 1] + 1;
    const float inside = z_[begin + (i - begin) / 2];
    const float beside = std::min(z_[begin - 1], z_[i]);
    if (right - left < kMinSpanWidth) return;
    if (!(beside - inside >= min_relief_ * inside)) return;
    SilhouetteSpan span;
    span.row = static_cast<std::int32_t>(v);
    span.begin = left;
    span.end = right;
    span.left_gap = left - column_[begin - 1] - 1;
    span.right_gap = column_[i] - right;
    span.left_sharp = is_sharp(begin);
    span.right_sharp = is_sharp(i);
    spans_.push_back(span);
    span_depth_.push_back(inside);
  }

  /// Is the step before pixel i between two surfaces of three adjacent pixels each?
  [[nodiscard]] bool is_sharp(std::size_t i) const {
    if (i < 3 || i + 2 >= z_.size() || column_[i + 2] - column_[i - 3] != 5) return false;
    return joined(i - 3, i - 2) && joined(i - 2, i - 1) && joined(i, i + 1) && joined(i + 1, i + 2);
  }

  const DepthView& depth_;
  const DepthStep& step_;
  float min_relief_;
  std::vector<SilhouetteSpan>& spans_;
  std::vector<float>& span_depth_;
  std::vector<std::int32_t> column_;
  std::vector<float> z_;
  std::vector<std::size_t> open_;  ///< First pixels of spans without an end yet.
};

/// Gives one number to the spans of an object: spans of neighbouring rows that overlap by half of
/// the shorter one and have about the same depth.
void number_objects(std::vector<SilhouetteSpan>& spans, const std::vector<float>& depth) {
  const auto count = static_cast<std::int32_t>(spans.size());
  UnionFind sets(count);
  std::int32_t first = 0;
  for (std::int32_t i = 0; i < count; ++i) {
    constexpr std::int32_t kMaxRows = 2;
    while (spans[first].row < spans[i].row - kMaxRows) ++first;
    for (std::int32_t j = first; j < i && spans[j].row < spans[i].row; ++j) {
      const std::int32_t common =
          std::min(spans[i].end, spans[j].end) - std::max(spans[i].begin, spans[j].begin);
      const std::int32_t shorter =
          std::min(spans[i].end - spans[i].begin, spans[j].end - spans[j].begin);
      constexpr float kAlike = 0.15F;  // of the depth
      const bool alike = std::abs(depth[i] - depth[j]) <= kAlike * std::min(depth[i], depth[j]);
      if (alike && 2 * common >= shorter) sets.join(i, j);
    }
  }
  for (std::int32_t i = 0; i < count; ++i) spans[i].object = sets.root(i);
}

}  // namespace

std::vector<double> depth_noise(const DepthView& depth, const DepthNoiseOptions& options) {
  check_millimetres(depth);
  if (options.region < 2 || options.region > kMaxImageSide) {
    throw InputError("region: expected 2 to " + std::to_string(kMaxImageSide) + ", got " +
                     std::to_string(options.region));
  }
  if (!(options.sigma >= 0.1 && options.sigma <= 100.0)) {
    throw InputError("sigma: expected 0.1 to 100, got " + number_text(options.sigma));
  }
  const std::array<double, kWindow> weights = gaussian(options.sigma);
  const std::int64_t rows = depth.rows, cols = depth.cols, side = options.region;
  const std::int64_t across = (cols + side - 1) / side, down = (rows + side - 1) / side;
  std::vector<double> smooth(rows * cols);  // smoothed along rows only
  for (std::int64_t v = 0; v < rows; ++v) {
    const std::uint16_t* line = depth.millimetres + v * cols;
    for (std::int64_t u = 0; u < cols; ++u) {
      double sum = 0.0;
      for (std::int64_t k = -kWindowReach; k <= kWindowReach; ++k) {
        sum += weights[k + kWindowReach] * line[mirrored(u + k, cols)];
      }
      smooth[v * cols + u] = sum;
    }
  }
  std::vector<double> means(static_cast<std::size_t>(across * down), 0.0);
  for (std::int64_t v = 0; v < rows; ++v) {
    for (std::int64_t u = 0; u < cols; ++u) {
      double sum = 0.0;
      for (std::int64_t k = -kWindowReach; k <= kWindowReach; ++k) {
        sum += weights[k + kWindowReach] * smooth[mirrored(v + k, rows) * cols + u];
      }
      means[v / side * across + u / side] += std::abs(depth.millimetres[v * cols + u] - sum);
    }
  }
  for (std::int64_t j = 0; j < down; ++j) {
    for (std::int64_t i = 0; i < across; ++i) {
      const std::int64_t height = std::min(side, rows - j * side);
      const std::int64_t width = std::min(side, cols - i * side);
      means[j * across + i] /= static_cast<double>(width * height);
    }
  }
  return means;
}

std::vector<SilhouetteSpan> silhouette_spans(const DepthView& depth, double focal,
                                             double min_relief) {
  check_millimetres(depth);
  if (!(min_relief >= 0.0 && min_relief <= 1.0)) {
    throw InputError("min_relief: expected 0 to 1, got " + number_text(min_relief));
  }
  const DepthStep step(DepthStepOptions{}, focal);
  std::vector<SilhouetteSpan> spans;
  std::vector<float> span_depth;
  RowScanner scanner(depth, step, min_relief, spans, span_depth);
  for (std::int64_t v = 0; v < depth.rows; ++v) scanner.scan(v);
  number_objects(spans, span_depth);
  return spans;
}

}  // namespace manip3d
