#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

/// @file
/// A forged scan with its ground truth, and the one edit that every attack comes down to.
namespace manip3d {

/// Changes of a scan by an attack. Rows are ascending and without repetition; none is both removed
/// and moved.
struct Edit {
  std::vector<std::int32_t> removed;  ///< Rows of the scan.
  std::vector<std::int32_t> moved;    ///< Rows of the scan.
  Points moved_to;                    ///< One row for each of `moved`.
  Points added;                       ///< Appended, in this order.
  Intensities added_intensity;        ///< One per added point, or none: then 0.
};

/// A forged scan. Points that nobody touched keep their order and their bits; added ones come last.
struct Forgery {
  LargeArray<float> points;              ///< (M, 3), row after row.
  LargeArray<float> intensity;           ///< (M,), or (0,) where the scan has none.
  std::vector<std::int32_t> added;       ///< Rows of the forged scan, ascending.
  std::vector<std::int32_t> moved;       ///< Rows of the forged scan, ascending.
  std::vector<std::int32_t> moved_from;  ///< Rows of the moved points in the original scan.
  std::vector<std::int32_t> removed;     ///< Rows of the original scan, ascending.
  OrientedBox box;  ///< Around what was added and moved; else around what was removed.
  Eigen::Matrix4d transform =
      Eigen::Matrix4d::Identity();  ///< How the object was moved, if it was.
};

/// Carries out an edit: one pass over the scan. The same bytes for any number of threads. A point
/// that is moved to where it is stays untouched.
/// @throws InputError  more than 2^31 - 1 points. Does not look for NaN among the scan's points.
Forgery apply_edit(const PointsView& scan, Edit edit, int num_threads = 0,
                   const Progress& progress = {});

}  // namespace manip3d
