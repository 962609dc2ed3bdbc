#pragma once

#include <cstdio>
#include <cstdlib>

#include "manip3d/error.hpp"

/// @file
/// What fuzz targets of kernels hold against them.
namespace manip3d::fuzzing {

/// Ends the program where `condition` does not hold, and says at which line of the target.
inline void require(bool condition, int line = __builtin_LINE()) {
  if (condition) return;
  std::fprintf(stderr, "line %d of the target does not hold\n", line);
  std::abort();
}

/// Bad input is refused; nothing else may be thrown.
template <typename Call>
void run(const Call& call) {
  try {
    call();
  } catch (const InputError&) {
  }
}

}  // namespace manip3d::fuzzing
