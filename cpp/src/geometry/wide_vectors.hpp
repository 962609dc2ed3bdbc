#pragma once

/// @file
/// Loops over four doubles at a time with AVX2, if the processor has it. Both paths execute the
/// same operations in the same order, so that results are equal bit for bit.

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
