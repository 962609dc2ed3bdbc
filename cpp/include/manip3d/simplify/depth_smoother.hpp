#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

struct DepthSmootherOptions {
  double newest_share = 0.15;  ///< Weight of the newest depth once a pixel has settled; (0, 1].
  double gate = 0.03;          ///< A pixel that changes by a larger part of its depth starts anew.
};

/// Recursive mean of each pixel of a depth sequence: what stands still loses its noise, what moves
/// is taken as it comes. The first frames after a start count alike (a running mean).
class DepthSmoother {
 public:
  /// @throws InputError  newest_share not in (0, 1]; gate is not > 0.
  explicit DepthSmoother(const DepthSmootherOptions& options = {});
  /// The smoothed frame: (rows, cols) metres, 0 where the newest frame has no measurement. Valid
  /// until the next call. A frame of another size starts anew.
  const std::vector<float>& add(const DepthView& depth);
  void reset() { mean_.clear(); }

 private:
  DepthSmootherOptions options_;
  std::int64_t rows_ = 0, cols_ = 0;
  std::vector<float> mean_;           ///< By pixel, metres; 0: nothing yet.
  std::vector<std::uint16_t> count_;  ///< By pixel: frames since its start.
  std::vector<float> out_;
};

}  // namespace manip3d
