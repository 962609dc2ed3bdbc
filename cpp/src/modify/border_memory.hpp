#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "modify/phantom_image.hpp"

namespace manip3d {

/// Keeps the phantom's ragged border still: an empty pixel that showed the phantom in the frame
/// before is filled if three of its neighbours show it now.
class BorderMemory {
 public:
  void reserve(std::size_t num_pixels);
  void forget() { time_s_ = -std::numeric_limits<double>::infinity(); }

  /// Lists the phantom's pixels within `box`, then fills those of the frame before.
  /// @param fills  memory; after the call what was filled.
  /// @returns the box of what was filled.
  PixelBox fill(const PixelBox& box, double time_s, const PixelRays& rays,
                const PhantomImage& image, std::vector<HoleFill>& fills);

 private:
  /// Pixels of the phantom in the last frame that had one of its own, before those that were filled
  /// because of the frame before it; and the same list of that frame.
  std::vector<std::int32_t> shown_, shown_before_;
  double time_s_ = -std::numeric_limits<double>::infinity();  ///< Time of `shown_`.
};

}  // namespace manip3d
