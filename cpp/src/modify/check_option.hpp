#pragma once

#include <string>

#include "manip3d/error.hpp"

namespace manip3d {

/// @throws InputError  `value` is not in [0, most].
inline void check_up_to(const char* name, double value, double most) {
  if (value >= 0.0 && value <= most) return;
  throw InputError(std::string(name) + ": expected 0 to " + number_text(most) + ", got " +
                   number_text(value));
}

}  // namespace manip3d
