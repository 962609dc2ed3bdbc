#pragma once

#include <cstdint>

#include "simplify/relief/surface.hpp"

namespace manip3d::relief_detail {

/// A step from a pixel to one of its eight neighbours. The two are linked by a dense edge or, if
/// they are diagonal neighbours, by a complete cell.
struct PixelStep {
  PixelStep(int across, int up, std::int32_t cols)
      : du(across), dv(up), cols_(cols), to_cell_(-(across > 0 ? 1 : 0) - (up > 0 ? cols : 0)) {}

  /// Whether a pixel is linked to the one before the step.
  [[nodiscard]] bool is_linked(const Surface& surface, std::int32_t pixel) const {
    const std::int32_t low = pixel + to_cell_;  // cell above and right of the lower pixel
    const auto cell = [&](std::int32_t at) -> unsigned { return at >= 0 ? surface.cell(at) : 0U; };
    if (dv == 0) return (cell(low) & kFirst) != 0 || (cell(low - cols_) & kSecond) != 0;
    if (du != 0) return (cell(low) & kFull) == kFull;
    const auto has_side = [](unsigned one, bool left) {  // whether the side ac or bd exists
      const bool turned = (one & kCutFromBToC) != 0;
      return (one & (turned == left ? kFirst : kSecond)) != 0;
    };
    // The last column of the previous row has no cells, so the index may cross its end.
    return has_side(cell(low), true) || has_side(cell(low - 1), false);
  }

  int du, dv;

 private:
  std::int32_t cols_, to_cell_;
};

/// Whether the dense surface continues from a pixel to one at this offset in columns and rows,
/// along a path that starts with the diagonal steps.
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
