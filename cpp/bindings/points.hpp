#pragma once

#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <memory>
#include <utility>
#include <vector>

#include "manip3d/geometry/large_array.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/oriented_box.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "numpy.hpp"

namespace manip3d::bindings {

/// Views points (N, 3) and their intensities, (N,) or (0,), without copying.
inline PointsView points_view(const CArray<float>& points, const CArray<float>& intensity) {
  return PointsView(rows<Points>(points, "points"), rows<Intensities>(intensity, "intensity"));
}

/// (center, size, yaw)
using BoxTuple = py::typing::Tuple<py::typing::List<double>, py::typing::List<double>, double>;

inline BoxTuple box_to_python(const OrientedBox& box) {
  return py::make_tuple(std::vector<double>{box.center.x(), box.center.y(), box.center.z()},
                        std::vector<double>{box.size.x(), box.size.y(), box.size.z()}, box.yaw);
}

inline std::vector<std::int32_t> row_vector(const CArray<std::int32_t>& values) {
  const auto view = rows<Indices>(values, "rows");
  return {view.data(), view.data() + view.size()};
}

/// Gives the memory of a LargeArray to NumPy without a copy.
template <int kColumns, typename T>
py::array to_numpy_rows(LargeArray<T>&& values) {
  auto owner = std::make_unique<LargeArray<T>>(std::move(values));
  const auto size = static_cast<py::ssize_t>(owner->size());
  T* data = owner->data();
  py::capsule free(owner.get(), [](void* p) { delete static_cast<LargeArray<T>*>(p); });
  owner.release();
  if constexpr (kColumns == 1) {
    return py::array_t<T>({size}, data, free);
  } else {
    return py::array_t<T>({size / kColumns, py::ssize_t{kColumns}}, data, free);
  }
}

}  // namespace manip3d::bindings
