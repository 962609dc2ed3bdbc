#pragma once

#include "manip3d/geometry/mesh.hpp"
#include "manip3d/progress.hpp"

namespace manip3d {

/// Distinct rows of a table. Rows are equal if they have the same bits, except that -0.0 equals
/// 0.0.
///
/// Values are numbered in the order of their first rows, so the numbering depends only on the
/// table.
struct Weld {
  Indices value;      ///< (N,) row -> value, in [0, num_values()).
  Indices first_row;  ///< (W,) value -> lowest row with this value; increasing.
  [[nodiscard]] std::int64_t num_values() const { return first_row.size(); }
};

/// Find equal rows of finite numbers by sorting, in O(N log N) time for any values.
/// @param progress  May cancel the work.
/// @tparam Columns  2 (texture coordinates) or 3 (positions, normals).
template <int Columns>
Weld weld_rows(const Eigen::Ref<const Rows<double, Columns>>& table, const Progress& progress = {});

/// Return `indices` with each row number replaced by its value; -1 stays -1.
Faces weld_indices(const Eigen::Ref<const Faces>& indices, const Weld& weld);

}  // namespace manip3d
