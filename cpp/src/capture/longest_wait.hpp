#pragma once

#include <chrono>

namespace manip3d {

/// The longest wait for a frame or packet. A longer timeout counts as this one, since its sum with
/// the clock's time need not fit 64 bits.
inline constexpr std::chrono::milliseconds kLongestWait = std::chrono::hours(1);

}  // namespace manip3d
