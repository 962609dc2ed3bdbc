#pragma once

#include <cstdio>
#include <cstdlib>

#include "manip3d/error.hpp"

/// @file
/// Checks that fuzz targets of kernels use.
namespace manip3d::fuzzing {

/// Aborts the program if `condition` is false, with the line of the target.
inline void require(bool condition, int line = __builtin_LINE()) {
  if (condition) return;
  std::fprintf(stderr, "line %d of the target does not hold\n", line);
  std::abort();
}

/// Runs a call that may refuse bad input. All other exceptions are findings.
template <typename Call>
void run(const Call& call) {
  try {
    call();
  } catch (const InputError&) {
  }
}

}  // namespace manip3d::fuzzing
