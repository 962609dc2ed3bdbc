#include "manip3d/forge/forgery.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <string>
#include <utility>

#include "geometry/dart_board.hpp"
#include "geometry/select_rows.hpp"
#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"

namespace manip3d {
namespace {

using Iterator = std::vector<std::int32_t>::const_iterator;

// Calls run(from, to, shift) for each run [from, to) of rows in [begin, end) that are kept. The
// rows move up by `shift`.
template <typename Run>
void for_kept_runs(const std::vector<std::int32_t>& removed, std::int64_t begin, std::int64_t end,
                   const Run& run) {
  const Iterator first = std::lower_bound(removed.begin(), removed.end(), begin);
  std::int64_t shift = first - removed.begin();
  std::int64_t from = begin;
  for (Iterator row = first; row != removed.end() && *row < end; ++row, ++shift) {
    if (*row > from) run(from, std::int64_t{*row}, shift);
    from = std::int64_t{*row} + 1;
  }
  if (from < end) run(from, end, shift);
}

void copy_kept(const PointsView& scan, const std::vector<std::int32_t>& removed, int num_threads,
               const Progress& progress, Forgery& forged) {
  const float* xyz = scan.points.data();
  const float* intensity = scan.intensity.data();
  parallel_chunks(
      scan.num_points(), kPointChunk, num_threads,
      [&](std::int64_t begin, std::int64_t end) {
        for_kept_runs(removed, begin, end, [&](std::int64_t from, std::int64_t to, std::int64_t k) {
          const auto size = static_cast<std::size_t>(to - from) * sizeof(float);
          std::memcpy(forged.points.data() + 3 * (from - k), xyz + 3 * from, 3 * size);
          if (scan.has_intensity()) {
            std::memcpy(forged.intensity.data() + (from - k), intensity + from, size);
          }
        });
      },
      progress);
}

void move_points(const Edit& edit, Forgery& forged) {
  for (std::size_t i = 0; i < edit.moved.size(); ++i) {
    const auto before = std::lower_bound(edit.removed.begin(), edit.removed.end(), edit.moved[i]);
    const auto row = static_cast<std::int32_t>(edit.moved[i] - (before - edit.removed.begin()));
    forged.moved.push_back(row);
    std::memcpy(forged.points.data() + 3 * std::int64_t{row},
                edit.moved_to.data() + 3 * static_cast<std::int64_t>(i), 3 * sizeof(float));
  }
  forged.moved_from = edit.moved;
}

void append_points(const PointsView& scan, const Edit& edit, std::int64_t first, Forgery& forged) {
  const std::int64_t count = edit.added.rows();
  for (std::int64_t i = 0; i < count; ++i) {
    forged.added.push_back(static_cast<std::int32_t>(first + i));
  }
  std::copy_n(edit.added.data(), 3 * count, forged.points.data() + 3 * first);
  if (!scan.has_intensity()) return;
  if (edit.added_intensity.rows() > 0) {
    std::copy_n(edit.added_intensity.data(), count, forged.intensity.data() + first);
  } else {
    std::fill_n(forged.intensity.data() + first, count, 0.0F);
  }
}

// Removes the moves that change nothing, because the ground truth lists changed points only.
void drop_idle_moves(const PointsView& scan, Edit& edit) {
  Eigen::Index kept = 0;
  for (std::size_t i = 0; i < edit.moved.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    if (edit.moved_to.row(row) == scan.points.row(edit.moved[i])) continue;
    edit.moved[kept] = edit.moved[i];
    edit.moved_to.row(kept++) = edit.moved_to.row(row);
  }
  edit.moved.resize(kept);
  edit.moved_to.conservativeResize(kept, 3);
}

OrientedBox box_of(const PointsView& scan, const Edit& edit) {
  if (edit.added.rows() + edit.moved_to.rows() == 0) return box_around(scan, edit.removed);
  Points touched(edit.added.rows() + edit.moved_to.rows(), 3);
  touched << edit.added, edit.moved_to;
  std::vector<std::int32_t> rows(touched.rows());
  for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = static_cast<std::int32_t>(i);
  return box_around(view_of(touched), rows);
}

}  // namespace

Forgery apply_edit(const PointsView& scan, Edit edit, int num_threads, const Progress& progress) {
  drop_idle_moves(scan, edit);
  const std::int64_t kept = scan.num_points() - static_cast<std::int64_t>(edit.removed.size());
  const std::int64_t count = kept + edit.added.rows();
  if (count > std::numeric_limits<std::int32_t>::max()) {
    throw InputError("points: expected at most 2147483647 in the forged scan, got " +
                     std::to_string(count));
  }
  Forgery forged;
  forged.points = LargeArray<float>(3 * count);
  if (scan.has_intensity()) forged.intensity = LargeArray<float>(count);
  copy_kept(scan, edit.removed, num_threads, progress, forged);
  move_points(edit, forged);
  append_points(scan, edit, kept, forged);
  forged.box = box_of(scan, edit);
  forged.removed = std::move(edit.removed);
  return forged;
}

}  // namespace manip3d
