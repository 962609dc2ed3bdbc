#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "modify/phantom_image.hpp"

namespace manip3d {

/// Prevents the phantom's ragged border from flickering: an empty pixel that showed the phantom in
/// the previous frame is filled if three of its neighbours show it now.
class BorderMemory {
 public:
  void reserve(std::size_t num_pixels);
  void forget() { time_s_ = -std::numeric_limits<double>::infinity(); }

  /// Lists the phantom's pixels within `box`, then fills those of the previous frame that qualify.
  /// @param fills  Memory; after the call, the pixels that were filled.
  /// @returns the bounding box of the filled pixels.
  PixelBox fill(const PixelBox& box, double time_s, const PixelRays& rays,
                const PhantomImage& image, std::vector<HoleFill>& fills);

 private:
  /// Pixels of the phantom in the last two frames, without those that were filled from the frame
  /// before.
  std::vector<std::int32_t> shown_, shown_before_;
  double time_s_ = -std::numeric_limits<double>::infinity();  ///< Time of `shown_`.
};

}  // namespace manip3d
