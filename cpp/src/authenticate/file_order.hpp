#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"

namespace manip3d {

/// Points that are not where the scanner would have written them: rings from the highest to the
/// lowest, azimuths ascending within each, from 0 or from where most rings begin (a frame that was
/// turned about the vertical afterwards). Rows that were shifted round are in order. The longest
/// subsequence in order is taken for the scanner's; of the others, those are named that would have
/// to move by more than rounding. Ascending. O(n log n).
std::vector<std::int32_t> misplaced_in_file(const LatticeReading& reading);

}  // namespace manip3d
