#pragma once

#include <pybind11/pybind11.h>

#include <vector>

#include "manip3d/geometry/mesh.hpp"
#include "numpy.hpp"

namespace manip3d::bindings {

/// Borrows the arrays of a `manip3d.Mesh` for the duration of one call. It owns references to them,
/// so that the views stay valid while the GIL is released.
class BorrowedMesh {
 public:
  explicit BorrowedMesh(const py::object& mesh);
  [[nodiscard]] const MeshView& view() const { return *view_; }

 private:
  std::vector<py::object> arrays_;
  std::unique_ptr<MeshView> view_;
};

/// Text of a file, which may contain bytes that are not UTF-8.
py::str readable(const std::string& bytes);

/// Converts the materials of a `manip3d.Mesh`.
std::vector<Material> materials_of(const py::object& mesh);

/// A `manip3d.Mesh` that takes over the tables of `mesh`.
py::object mesh_to_python(TriangleMesh&& mesh);

/// A list of `manip3d.Material`.
py::list materials_to_python(const std::vector<Material>& materials);

/// A `manip3d.Mesh` with the tables of `mesh` and these materials.
py::object mesh_to_python(TriangleMesh&& mesh, const py::list& materials);

/// A `manip3d.Mesh` with the tables of `mesh`, and with the materials and the file name of
/// `source`.
py::object mesh_to_python(TriangleMesh&& mesh, const py::object& source);

}  // namespace manip3d::bindings
