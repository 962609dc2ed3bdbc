#pragma once

#include <algorithm>
#include <span>

namespace manip3d {

/// Standard deviation of a normal distribution over its median absolute value.
inline constexpr double kNormalMad = 1.4826;

/// The one of the two middle values of an even number of values that is the median.
enum class Middle { kLower, kUpper };

/// The median of at least one value; reorders the values.
template <typename T>
T median(std::span<T> values, Middle middle = Middle::kUpper) {
  const auto at = values.begin() + (values.size() - (middle == Middle::kLower ? 1 : 0)) / 2;
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace manip3d
