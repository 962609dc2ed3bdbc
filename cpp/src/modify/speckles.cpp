#include "manip3d/modify/speckles.hpp"

#include <algorithm>
#include <cstdlib>

#include "modify/pixel_bounds.hpp"

namespace manip3d {
namespace {

/// Only the bounding box of the person is processed, because it is a fraction of the image.
PixelBox labelled_box(std::int64_t rows, std::int64_t cols, const std::uint8_t* labels) {
  PixelBounds bounds;
  for (std::int64_t v = 0; v < rows; ++v) {
    const std::uint8_t* row = labels + v * cols;
    std::uint8_t any = 0;
    for (std::int64_t u = 0; u < cols; ++u) any |= row[u];  // vectorized
    if (any == 0) continue;
    std::int64_t first = 0, last = cols - 1;
    while (row[first] == 0) ++first;
    while (row[last] == 0) --last;
    bounds.add(first, v);
    bounds.add(last, v);
  }
  return bounds.box();
}

/// Fills the pixels of a box between their neighbours `step` before and after them.
void fill_between(const PixelBox& inner, std::int64_t cols, std::int64_t step, std::uint16_t* depth,
                  std::uint8_t* labels) {
  constexpr double kMaxStep = 0.03;  // share of the depth
  for (std::int64_t v = inner.v0; v < inner.v0 + inner.height; ++v) {
    for (std::int64_t i = v * cols + inner.u0; i < v * cols + inner.u0 + inner.width; ++i) {
      const std::uint8_t bone = labels[i - step];
      if (labels[i] != 0 || bone == 0 || bone != labels[i + step]) continue;
      const int before = depth[i - step], after = depth[i + step];
      if (!(std::abs(before - after) < kMaxStep * before)) continue;
      depth[i] = static_cast<std::uint16_t>((before + after) / 2);
      labels[i] = bone;
    }
  }
}

}  // namespace

void fill_speckles(std::int64_t rows, std::int64_t cols, std::uint16_t* depth,
                   std::uint8_t* labels) {
  const PixelBox box = labelled_box(rows, cols, labels);
  if (box.width > 2) {
    fill_between({box.u0 + 1, box.v0, box.width - 2, box.height}, cols, 1, depth, labels);
  }
  if (box.height > 2) {
    fill_between({box.u0, box.v0 + 1, box.width, box.height - 2}, cols, cols, depth, labels);
  }
}

}  // namespace manip3d
