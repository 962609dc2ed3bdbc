#include "manip3d/simplify/depth_smoother.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {

DepthSmoother::DepthSmoother(const DepthSmootherOptions& options) : options_(options) {
  if (!(options.newest_share > 0.0 && options.newest_share <= 1.0)) {
    throw InputError("newest_share: expected in (0, 1], got " +
                     std::to_string(options.newest_share));
  }
  if (!(options.gate > 0.0)) {
    throw InputError("gate: expected > 0, got " + std::to_string(options.gate));
  }
}

const std::vector<float>& DepthSmoother::add(const DepthView& depth) {
  const std::size_t size = depth.rows * depth.cols;
  if (mean_.size() != size || rows_ != depth.rows || cols_ != depth.cols) {
    rows_ = depth.rows;
    cols_ = depth.cols;
    mean_.assign(size, 0.0F);
    count_.assign(size, 0);
  }
  out_.assign(size, 0.0F);
  const auto share = static_cast<float>(options_.newest_share);
  const auto gate = static_cast<float>(options_.gate);
  for (std::size_t i = 0; i < size; ++i) {
    const float z = depth.at(static_cast<std::int64_t>(i));
    if (!(z > 0.0F)) {  // a pixel that is back soon goes on where it was
      out_[i] = z < 0.0F ? z : 0.0F;
      continue;
    }
    const bool stands_still = count_[i] > 0 && std::abs(z - mean_[i]) <= gate * mean_[i];
    count_[i] = stands_still ? static_cast<std::uint16_t>(std::min(count_[i] + 1, 60000)) : 1;
    const float weight = std::max(share, 1.0F / static_cast<float>(count_[i]));
    mean_[i] = stands_still ? mean_[i] + weight * (z - mean_[i]) : z;
    out_[i] = mean_[i];
  }
  return out_;
}

}  // namespace manip3d
