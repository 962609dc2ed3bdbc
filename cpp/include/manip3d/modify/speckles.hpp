#pragma once

#include <cstdint>

namespace manip3d {

/// Fills single lost pixels of a segmented person: a pixel without a bone between two of one bone,
/// whose depths differ by less than 3 %, gets their mean and their bone. First along rows, then
/// along columns.
/// @param depth   (rows, cols) millimetres, written.
/// @param labels  (rows, cols) bone of each pixel, 0: none; written.
void fill_speckles(std::int64_t rows, std::int64_t cols, std::uint16_t* depth,
                   std::uint8_t* labels);

}  // namespace manip3d
