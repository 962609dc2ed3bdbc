#pragma once

#include <cstdint>

namespace manip3d {

/// SplitMix64 [Steele, Lea & Flood, OOPSLA 2014]. Its state is a counter, so any thread can compute
/// any of its outputs directly.
inline std::uint64_t mix(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
  return z ^ (z >> 31);
}

/// The random number with this counter, 64 bits.
inline std::uint64_t random_bits(std::uint64_t seed, std::uint64_t counter) {
  return mix(mix(seed) + (counter + 1) * 0x9E3779B97F4A7C15U);
}

/// The uniform random number with this counter, in [0, 1).
inline double uniform(std::uint64_t seed, std::uint64_t counter) {
  return static_cast<double>(random_bits(seed, counter) >> 11) * 0x1p-53;
}

/// The approximately normal random number with this counter: mean 0, variance 1, magnitude at most
/// 6. It is the sum of twelve uniform numbers, because logarithms differ between libms.
inline double normal(std::uint64_t seed, std::uint64_t counter) {
  double sum = -6.0;
  for (std::uint64_t i = 0; i < 12; ++i) sum += uniform(seed, 12 * counter + i);
  return sum;
}

}  // namespace manip3d
