#include <pybind11/typing.h>

#include "manip3d/simplify/clean.hpp"
#include "mesh.hpp"
#include "modules.hpp"

namespace manip3d::bindings {
namespace {

using Fields = py::typing::Dict<py::str, py::object>;

Fields to_fields(CleanResult&& result, const py::object& source) {
  Fields fields;
  fields["mesh"] = to_python(std::move(result.mesh), source);
  fields["vertex_map"] = to_numpy(std::move(result.vertex_map));
  fields["face_map"] = to_numpy(std::move(result.face_map));
  fields["merged_vertices"] = result.merged_vertices;
  fields["unreferenced_vertices"] = result.unreferenced_vertices;
  fields["degenerate_faces"] = result.degenerate_faces;
  fields["duplicate_faces"] = result.duplicate_faces;
  fields["changed_faces"] = result.changed_faces;
  fields["changed_vertices"] = result.changed_vertices;
  return fields;
}

void bind_clean(py::module_& m) {
  py::enum_<Duplicates>(m, "Duplicates")
      .value("keep", Duplicates::kKeep)
      .value("same", Duplicates::kSame)
      .value("any", Duplicates::kAny);
  m.def(
      "clean",
      [](const py::object& mesh, bool weld, Duplicates duplicates) {
        const BorrowedMesh borrowed(mesh);
        CleanResult result;
        {
          const py::gil_scoped_release nogil;
          result = clean(borrowed.view(), {weld, duplicates});
        }
        return to_fields(std::move(result), mesh);
      },
      py::arg("mesh"), py::arg("weld"), py::arg("duplicates"));
}

}  // namespace

void bind_simplify(py::module_& m) { bind_clean(m); }

}  // namespace manip3d::bindings
