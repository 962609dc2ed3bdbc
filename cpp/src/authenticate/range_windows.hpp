#pragma once

#include <cstdint>
#include <vector>

#include "authenticate/ring_image.hpp"

namespace manip3d {

/// Points of a cell, and those whose range is more than a quarter step off.
struct RangeTally {
  std::int32_t points = 0;
  std::int32_t incoherent = 0;
};

/// Cells in windows that hold more incoherent ranges than chance explains.
///
/// The value is Chernoff's exponent of the strongest window that covers a cell: a window of
/// clean points reaches an exponent t with probability e^-t at most. Windows below `threshold`
/// count as 0. Columns go around the horizon.
RingImage<double> incoherent_windows(const RingImage<RangeTally>& cells, double incoherence,
                                     double threshold);

}  // namespace manip3d
