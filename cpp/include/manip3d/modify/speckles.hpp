#pragma once

#include <cstdint>

namespace manip3d {

/// Fill single missing pixels of a segmented person. A pixel without a bone between two pixels of
/// the same bone, whose depths differ by less than 3 %, gets their mean depth and their bone. Rows
/// are filled first, then columns.
/// @param depth   (rows, cols) millimetres, written.
/// @param labels  (rows, cols) bone of each pixel, 0: none; written.
void fill_speckles(std::int64_t rows, std::int64_t cols, std::uint16_t* depth,
                   std::uint8_t* labels);

}  // namespace manip3d
