#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include "interruptible.hpp"
#include "manip3d/simplify/clean.hpp"
#include "manip3d/simplify/collapse_record.hpp"
#include "manip3d/simplify/qem.hpp"
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

struct CollapseArrays {
  Rows<std::int32_t, 2> vertices;  // removed, kept
  Eigen::VectorXd errors;
};

CollapseArrays to_arrays(const std::vector<Collapse>& collapses) {
  const auto count = static_cast<Eigen::Index>(collapses.size());
  CollapseArrays arrays{Rows<std::int32_t, 2>(count, 2), Eigen::VectorXd(count)};
  for (Eigen::Index i = 0; i < count; ++i) {
    const Collapse& collapse = collapses[static_cast<std::size_t>(i)];
    arrays.vertices.row(i) << collapse.removed, collapse.kept;
    arrays.errors(i) = collapse.error;
  }
  return arrays;
}

Fields to_fields(QemResult&& r, const py::object& source) {
  CollapseArrays collapses = to_arrays(r.collapses);
  py::typing::Dict<py::str, std::int64_t> rejected;
  for (std::size_t i = 0; i < r.rejected.size(); ++i) {
    if (r.rejected[i] > 0) rejected[kRejectionNames[i]] = r.rejected[i];
  }
  Fields result;
  result["mesh"] = to_python(std::move(r.mesh), source);
  result["vertex_map"] = to_numpy(std::move(r.vertex_map));
  result["kept"] = to_numpy(std::move(r.kept));
  result["face_map"] = to_numpy(std::move(r.face_map));
  result["collapses"] = to_numpy(std::move(collapses.vertices));
  result["collapse_errors"] = to_numpy(std::move(collapses.errors));
  result["max_error"] = r.max_error;
  result["distance_bound"] = r.distance_bound;
  result["stop"] = r.stop;
  result["message"] = r.message;
  result["rejected"] = rejected;
  result["off_seam_collapses"] = r.off_seam_collapses;
  result["locked_vertices"] = r.locked_vertices;
  result["dropped_faces"] = r.dropped_faces;
  result["clamped_costs"] = r.clamped_costs;
  return result;
}

void bind_options(py::module_& m) {
  py::enum_<BoundaryTerm>(m, "BoundaryTerm")
      .value("NONE", BoundaryTerm::kNone)
      .value("FREEZE", BoundaryTerm::kFreeze)
      .value("WEIGHT", BoundaryTerm::kWeight)
      .value("CURVATURE", BoundaryTerm::kCurvature);
  py::enum_<BoundaryCurvature>(m, "BoundaryCurvature")
      .value("TURNING", BoundaryCurvature::kTurning)
      .value("PAPER", BoundaryCurvature::kPaper);
  py::enum_<TextureTerm>(m, "TextureTerm")
      .value("NONE", TextureTerm::kNone)
      .value("QUADRIC5", TextureTerm::kQuadric5)
      .value("SEAM_PLANES", TextureTerm::kSeamPlanes)
      .value("SEAM_PAPER", TextureTerm::kSeamPaper)
      .value("SEAM_LOCK", TextureTerm::kSeamLock);
  py::enum_<LinkCondition>(m, "LinkCondition")
      .value("MANIFOLD", LinkCondition::kManifold)
      .value("ALWAYS", LinkCondition::kAlways)
      .value("NEVER", LinkCondition::kNever);
  py::enum_<ComplexVertices>(m, "ComplexVertices")
      .value("KEEP", ComplexVertices::kKeep)
      .value("FREEZE", ComplexVertices::kFreeze);
  py::enum_<CollapseStop>(m, "CollapseStop")
      .value("TARGET_REACHED", CollapseStop::kTargetReached)
      .value("ERROR_LIMIT", CollapseStop::kErrorLimit)
      .value("DISTANCE_LIMIT", CollapseStop::kDistanceLimit)
      .value("NO_LEGAL_COLLAPSE", CollapseStop::kNoLegalCollapse)
      .value("REFUSED", CollapseStop::kRefused);
  py::class_<QemOptions>(m, "QemOptions")
      .def(py::init<>())
      .def_readwrite("target_faces", &QemOptions::target_faces)
      .def_readwrite("max_error", &QemOptions::max_error)
      .def_readwrite("max_distance", &QemOptions::max_distance)
      .def_readwrite("boundary", &QemOptions::boundary)
      .def_readwrite("boundary_weight", &QemOptions::boundary_weight)
      .def_readwrite("curvature", &QemOptions::curvature)
      .def_readwrite("texture", &QemOptions::texture)
      .def_readwrite("seam_weight", &QemOptions::seam_weight)
      .def_readwrite("complex_vertices", &QemOptions::complex_vertices)
      .def_readwrite("link_condition", &QemOptions::link_condition)
      .def_readwrite("quality_threshold", &QemOptions::quality_threshold);
}

void bind_qem(py::module_& m) {
  bind_options(m);
  m.def(
      "simplify_qem",
      [](const py::object& mesh, const QemOptions& options, const py::object& progress) {
        const BorrowedMesh borrowed(mesh);
        QemResult result;
        const Progress report = interruptible(progress);
        {
          const py::gil_scoped_release nogil;
          result = simplify_qem(borrowed.view(), options, report);
        }
        return to_fields(std::move(result), mesh);
      },
      py::arg("mesh"), py::arg("options"), py::arg("progress") = py::none());
  m.def(
      "faces_left",
      [](const py::object& mesh, const CArray<std::int32_t>& collapses) {
        const BorrowedMesh borrowed(mesh);
        const auto vertices = rows<Rows<std::int32_t, 2>>(collapses, "collapses");
        std::vector<std::pair<std::int32_t, std::int32_t>> record;
        for (Eigen::Index i = 0; i < vertices.rows(); ++i) {
          record.emplace_back(vertices(i, 0), vertices(i, 1));
        }
        std::vector<std::int64_t> left;
        {
          const py::gil_scoped_release nogil;
          left = faces_left(borrowed.view(), record);
        }
        return to_numpy(std::move(left));
      },
      py::arg("mesh"), py::arg("collapses").noconvert());
  m.def(
      "replay_collapses",
      [](const py::object& mesh, const QemOptions& options, const CArray<std::int32_t>& collapses,
         const CArray<double>& errors, std::int64_t target_faces) {
        const BorrowedMesh borrowed(mesh);
        const auto vertices = rows<Rows<std::int32_t, 2>>(collapses, "collapses");
        if (errors.size() != vertices.rows()) {
          throw InputError("collapse_errors: expected one per collapse (" +
                           std::to_string(vertices.rows()) + "), got " +
                           std::to_string(errors.size()));
        }
        std::vector<Collapse> record;
        for (Eigen::Index i = 0; i < vertices.rows(); ++i) {
          record.push_back({vertices(i, 0), vertices(i, 1), errors.data()[i]});
        }
        QemResult result;
        {
          const py::gil_scoped_release nogil;
          result = replay_collapses(borrowed.view(), options, record, target_faces);
        }
        return to_fields(std::move(result), mesh);
      },
      py::arg("mesh"), py::arg("options"), py::arg("collapses").noconvert(),
      py::arg("collapse_errors").noconvert(), py::arg("target_faces"));
}

}  // namespace

void bind_simplify(py::module_& m) {
  bind_clean(m);
  bind_qem(m);
}

}  // namespace manip3d::bindings
