#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/authenticate/lattice.hpp"

namespace manip3d {

/// Returns the points, ascending, that are not where the scanner would have written them. A file is
/// in order if its rings go from the highest to the lowest, with ascending azimuths in each ring,
/// from 0 or from the azimuth at which most rings begin (in a frame that was rotated about the
/// vertical). A cyclic shift of the rows is in order too. The longest subsequence in order is taken
/// as the scanner's; of the other points, those are returned whose distance from their neighbours
/// in it exceeds rounding. O(n log n).
std::vector<std::int32_t> misplaced_in_file(const LatticeReading& reading, double azimuth_step);

}  // namespace manip3d
