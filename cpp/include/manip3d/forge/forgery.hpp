#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/progress.hpp"

/// @file
/// A forged scan with its ground truth, and the edit that every attack is reduced to.
namespace manip3d {

/// Changes of a scan by an attack. Rows are ascending and without repetition; no row is both
/// removed and moved.
struct Edit {
  std::vector<std::int32_t> removed;  ///< Row numbers of the scan.
  std::vector<std::int32_t> moved;    ///< Row numbers of the scan.
  Points moved_to;                    ///< New position of each row of `moved`.
  Points added;                       ///< Points to append, in this order.
  Intensities added_intensity;        ///< One per added point; empty: 0.
};

/// A forged scan. Unchanged points keep their order and their bits; added points come last.
struct Forgery {
  LargeArray<float> points;              ///< (M, 3), row by row.
  LargeArray<float> intensity;           ///< (M,); empty if the scan has no intensities.
  std::vector<std::int32_t> added;       ///< Row numbers in the forged scan, ascending.
  std::vector<std::int32_t> moved;       ///< Row numbers in the forged scan, ascending.
  std::vector<std::int32_t> moved_from;  ///< Row numbers of the moved points in the original scan.
  std::vector<std::int32_t> removed;     ///< Row numbers in the original scan, ascending.
  /// Box around the added and moved points; without these, around the removed ones.
  OrientedBox box;
  /// Transform of the object; identity if it did not move.
  Eigen::Matrix4d transform = Eigen::Matrix4d::Identity();
};

/// Carries out an edit in one pass over the scan. The result has the same bytes for any number of
/// threads. A point that is moved to its own position counts as unchanged.
/// @throws InputError  the result has more than 2^31 - 1 points. The points are not checked for
///                     NaN.
Forgery apply_edit(const PointsView& scan, Edit edit, int num_threads = 0,
                   const Progress& progress = {});

}  // namespace manip3d
