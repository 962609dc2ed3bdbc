#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "io/warnings.hpp"

namespace manip3d {

/// Leaves faces without an attribute (normals, texture coordinates) where one of its rows has a
/// number that is not finite; such rows become 0.
/// @param rows   `num_rows` rows of `num_columns` numbers.
/// @param faces  Three indices of rows for each face; -1: none.
/// @param what   Name of the attribute, for the warning.
inline void leave_out_nan(double* rows, std::int64_t num_rows, int num_columns, std::int32_t* faces,
                          std::int64_t num_faces, const char* what,
                          std::vector<std::string>& warnings) {
  std::vector<bool> is_bad(num_rows);
  bool is_any = false;
  for (std::int64_t i = 0; i < num_rows; ++i) {
    double* row = rows + i * num_columns;
    is_bad[i] = !std::all_of(row, row + num_columns, [](double x) { return std::isfinite(x); });
    if (!is_bad[i]) continue;
    std::fill_n(row, num_columns, 0.0);
    is_any = true;
  }
  if (!is_any) return;
  std::int64_t count = 0;
  for (std::int32_t* face = faces; face != faces + 3 * num_faces; face += 3) {
    if (std::none_of(face, face + 3, [&](std::int32_t c) { return c >= 0 && is_bad[c]; })) continue;
    std::fill_n(face, 3, -1);
    ++count;
  }
  warn(warnings, std::string(what) + " that are no finite numbers are left out (faces: " +
                     std::to_string(count) + ")");
}

}  // namespace manip3d
