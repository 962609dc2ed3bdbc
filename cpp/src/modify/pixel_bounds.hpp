#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "manip3d/geometry/range_image.hpp"

namespace manip3d {

/// The smallest box around pixels.
class PixelBounds {
 public:
  void add(std::int64_t u, std::int64_t v) {
    u0_ = std::min(u0_, u);
    v0_ = std::min(v0_, v);
    u1_ = std::max(u1_, u + 1);
    v1_ = std::max(v1_, v + 1);
  }
  void add(const PixelBox& box) {
    if (box.empty()) return;
    add(box.u0, box.v0);
    add(box.u0 + box.width - 1, box.v0 + box.height - 1);
  }
  [[nodiscard]] PixelBox box() const {
    return u1_ == 0 ? PixelBox{} : PixelBox{u0_, v0_, u1_ - u0_, v1_ - v0_};
  }

 private:
  std::int64_t u0_ = std::numeric_limits<std::int64_t>::max(), v0_ = u0_, u1_ = 0, v1_ = 0;
};

}  // namespace manip3d
