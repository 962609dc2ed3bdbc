#pragma once

#include <cstdlib>

#include "manip3d/error.hpp"

/// @file
/// What fuzz targets of kernels hold against them.
namespace manip3d::fuzzing {

inline void require(bool condition) {
  if (!condition) std::abort();
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
