#pragma once

#include <cmath>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {

enum class MayBeInfinite : bool { kNo, kYes };

/// @throws InputError  `value` is negative, NaN or, unless it may be, infinite.
inline void check_not_negative(const char* name, double value,
                               MayBeInfinite may_be = MayBeInfinite::kNo) {
  if (value >= 0.0 && (may_be == MayBeInfinite::kYes || std::isfinite(value))) return;
  throw InputError(std::string(name) + ": expected a number >= 0, got " + number_text(value));
}

}  // namespace manip3d
