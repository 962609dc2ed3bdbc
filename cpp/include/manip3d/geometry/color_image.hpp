#pragma once

#include <cstdint>

namespace manip3d {

/// A colour image, borrowed; (rows, cols, 3) R, G, B.
struct ColorView {
  std::int64_t rows = 0, cols = 0;
  const std::uint8_t* pixels = nullptr;
};

}  // namespace manip3d
