#pragma once

#include <cstdint>

#include "simplify/relief_surface.hpp"

namespace manip3d::relief_detail {

/// Steps from a pixel to one of the eight around it, and what tells whether the two are linked: by
/// a dense edge, or by a whole cell where they are diagonal.
struct PixelStep {
  PixelStep(int across, int up, std::int32_t cols)
      : du(across), dv(up), cols_(cols), to_cell_(-(across > 0 ? 1 : 0) - (up > 0 ? cols : 0)) {}

  /// Is a pixel linked to the one before it?
  [[nodiscard]] bool is_linked(const Surface& surface, std::int32_t pixel) const {
    const std::int32_t low = pixel + to_cell_;  // the cell above and right of the lesser one
    const auto cell = [&](std::int32_t at) -> unsigned { return at >= 0 ? surface.cell(at) : 0U; };
    if (dv == 0) return (cell(low) & kFirst) != 0 || (cell(low - cols_) & kSecond) != 0;
    if (du != 0) return (cell(low) & kFull) == kFull;
    const auto has_side = [](unsigned one, bool left) {  // ac or bd
      const bool turned = (one & kCutFromBToC) != 0;
      return (one & (turned == left ? kFirst : kSecond)) != 0;
    };
    // The last column of the row before has no cells.
    return has_side(cell(low), true) || has_side(cell(low - 1), false);
  }

  int du, dv;

 private:
  std::int32_t cols_, to_cell_;
};

/// Does the dense surface go on from a pixel to one so many columns and rows away, over the pixels
/// that diagonal steps lead to first?
inline bool are_linked(const Surface& surface, std::int32_t pixel, int du, int dv) {
  const auto sign = [](int value) { return (value > 0 ? 1 : 0) - (value < 0 ? 1 : 0); };
  while (du != 0 || dv != 0) {
    const PixelStep step(sign(du), sign(dv), surface.cols());
    pixel += step.dv * surface.cols() + step.du;
    if (!step.is_linked(surface, pixel)) return false;
    du -= step.du, dv -= step.dv;
  }
  return true;
}

}  // namespace manip3d::relief_detail
