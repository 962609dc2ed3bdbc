#pragma once

/// @file
/// Loops over doubles with the four places of AVX2 where the processor has them. The same
/// operations in the same order on either path, so that the results are the same, bit for bit.

#include "geometry/always_inline.hpp"

#if defined(__x86_64__)
#define MANIP3D_AVX2 [[gnu::target("avx2")]]

namespace manip3d {

inline bool has_avx2() {
  static const bool has = __builtin_cpu_supports("avx2") != 0;
  return has;
}

}  // namespace manip3d
#endif
