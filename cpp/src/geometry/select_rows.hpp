#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/point_cloud.hpp"

namespace manip3d {

constexpr std::int64_t kPointChunk = 1 << 16;

/// Whether a row of a scan has no return: drivers of organised clouds write (0, 0, 0) for it.
inline bool is_no_return(float x, float y, float z) { return x == 0.0F && y == 0.0F && z == 0.0F; }

/// Return the rows for which `predicate(x, y, z)` holds, ascending. Checks the view in the same
/// pass over the points, because a second pass over ten million of them takes too long.
template <typename Predicate>
std::vector<std::int32_t> select_rows(const PointsView& view, int num_threads,
                                      const Predicate& predicate, const Progress& progress = {}) {
  const std::int64_t count = view.num_points();
  std::vector<std::vector<std::int32_t>> found((count + kPointChunk - 1) / kPointChunk);
  std::vector<float> finite(found.size(), 0.0F);
  const float* xyz = view.points.data();
  const auto select = [&](std::int64_t begin, std::int64_t end) {
    std::vector<std::int32_t>& rows = found[begin / kPointChunk];
    float sum = 0.0F;  // 0 times infinity or NaN is NaN
    for (std::int64_t i = begin; i < end; ++i) {
      const float x = xyz[3 * i];
      const float y = xyz[3 * i + 1];
      const float z = xyz[3 * i + 2];
      sum += x * 0.0F + (y * 0.0F + z * 0.0F);
      if (predicate(x, y, z)) rows.push_back(static_cast<std::int32_t>(i));
    }
    finite[begin / kPointChunk] = sum;
  };
  parallel_chunks(count, kPointChunk, num_threads, select, progress);
  for (const float sum : finite) {
    if (!(sum == 0.0F)) check_points(view);  // throws and names the row
  }
  std::vector<std::int32_t> rows;
  for (const auto& part : found) rows.insert(rows.end(), part.begin(), part.end());
  return rows;
}

/// check_points with all threads, for kernels without a selection.
inline void check_points_everywhere(const PointsView& view, int num_threads,
                                    const Progress& progress = {}) {
  select_rows(view, num_threads, [](float, float, float) { return false; }, progress);
  if (view.has_intensity() && view.intensity.rows() != view.num_points()) check_points(view);
}

/// Checked rows of a caller: ascending, without repetition.
/// @throws InputError  a row out of range.
inline std::vector<std::int32_t> checked_rows(std::vector<std::int32_t> rows,
                                              std::int64_t num_points) {
  std::sort(rows.begin(), rows.end());
  rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  if (!rows.empty() && !(rows.front() >= 0 && rows.back() < num_points)) {
    throw InputError("rows: expected 0 to " + std::to_string(num_points - 1) + ", got " +
                     std::to_string(rows.front() < 0 ? rows.front() : rows.back()));
  }
  return rows;
}

}  // namespace manip3d
