#pragma once

#include <cstdint>
#include <span>

#include "simplify/relief/coverage.hpp"
#include "simplify/relief/surface.hpp"

namespace manip3d::relief_detail {

/// Area of the part of a triangle over cells of pixels that lack a dense triangle there. The unit
/// is the area of a cell.
struct BridgedCells {
  double all = 0.0;
  double filled = 0.0;  ///< The part of it whose dense triangles filled pixels complete.
};

/// Clips a triangle to the missing dense triangles below it.
/// @param flaws   Result of count_flaws().
/// @param filled  By pixel: whether it was filled; or empty.
BridgedCells bridged_cells(const Surface& surface, std::span<const std::int32_t> flaws,
                           std::span<const std::uint8_t> filled, const Corners& t);

}  // namespace manip3d::relief_detail
