#include "manip3d/geometry/mesh.hpp"
#include "mesh.hpp"
#include "modules.hpp"

namespace manip3d::bindings {

void bind_geometry(py::module_& m) {
  m.def(
      "check_mesh",
      [](const py::object& mesh) {
        const BorrowedMesh borrowed(mesh);
        const py::gil_scoped_release nogil;
        check_mesh(borrowed.view());
      },
      py::arg("mesh"));
  m.def(
      "bounding_box",
      [](const py::object& mesh) {
        const BorrowedMesh borrowed(mesh);
        check_mesh(borrowed.view());
        const BoundingBox box = bounding_box(borrowed.view());
        Vertices corners(2, 3);
        corners << box.min.transpose(), box.max.transpose();
        return to_numpy(std::move(corners));
      },
      py::arg("mesh"));
}

}  // namespace manip3d::bindings
