#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "manip3d/error.hpp"

namespace manip3d::bindings {

namespace py = pybind11;

template <typename T>
using CArray = py::array_t<T, py::array::c_style>;

/// Views an (N, columns) array as a row-major map without copying.
template <typename Matrix>
Eigen::Map<const Matrix> rows(const CArray<typename Matrix::Scalar>& array, const char* name) {
  constexpr int kColumns = Matrix::ColsAtCompileTime;
  const bool ok =
      kColumns == 1 ? array.ndim() == 1 : (array.ndim() == 2 && array.shape(1) == kColumns);
  if (!ok) {
    std::string shape = "(";
    for (py::ssize_t i = 0; i < array.ndim(); ++i) {
      shape += std::to_string(array.shape(i)) + (i + 1 < array.ndim() ? ", " : "");
    }
    const std::string expected = kColumns == 1 ? "(N,)" : "(N, " + std::to_string(kColumns) + ")";
    throw InputError(std::string(name) + ": expected shape " + expected + ", got " + shape + ")");
  }
  return Eigen::Map<const Matrix>(array.data(), array.shape(0), kColumns);
}

/// Moves a matrix to the heap and gives its buffer to NumPy without a copy.
template <typename Matrix>
py::array to_numpy(Matrix&& matrix) {
  using Plain = std::decay_t<Matrix>;
  using Scalar = typename Plain::Scalar;
  static_assert(Plain::ColsAtCompileTime == 1 || Plain::IsRowMajor,
                "NumPy reads rows: a matrix by columns would be transposed");
  auto owner = std::make_unique<Plain>(std::forward<Matrix>(matrix));
  const auto num_rows = static_cast<py::ssize_t>(owner->rows());
  Scalar* data = owner->data();
  py::capsule free(owner.get(), [](void* p) { delete static_cast<Plain*>(p); });
  owner.release();
  if constexpr (Plain::ColsAtCompileTime == 1) {
    return py::array_t<Scalar>({num_rows}, data, free);
  } else {
    return py::array_t<Scalar>({num_rows, py::ssize_t{Plain::ColsAtCompileTime}}, data, free);
  }
}

template <typename T>
py::array to_numpy(std::vector<T>&& values) {
  auto owner = std::make_unique<std::vector<T>>(std::move(values));
  const auto size = static_cast<py::ssize_t>(owner->size());
  T* data = owner->data();
  py::capsule free(owner.get(), [](void* p) { delete static_cast<std::vector<T>*>(p); });
  owner.release();
  return py::array_t<T>({size}, data, free);
}

}  // namespace manip3d::bindings
