#include <pybind11/native_enum.h>
#include <pybind11/stl.h>

#include "fields.hpp"
#include "interruptible.hpp"
#include "manip3d/simplify/clean.hpp"
#include "manip3d/simplify/collapse_record.hpp"
#include "manip3d/simplify/fast.hpp"
#include "manip3d/simplify/qem.hpp"
#include "manip3d/simplify/quality.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

constexpr std::tuple kCleanFields{
    Field{"vertex_map", &CleanResult::vertex_map},
    Field{"face_map", &CleanResult::face_map},
    Field{"merged_vertices", &CleanResult::merged_vertices},
    Field{"unreferenced_vertices", &CleanResult::unreferenced_vertices},
    Field{"degenerate_faces", &CleanResult::degenerate_faces},
    Field{"duplicate_faces", &CleanResult::duplicate_faces},
    Field{"changed_faces", &CleanResult::changed_faces},
    Field{"changed_vertices", &CleanResult::changed_vertices},
};

constexpr std::tuple kQemFields{
    Field{"vertex_map", &QemResult::vertex_map},
    Field{"kept", &QemResult::kept},
    Field{"face_map", &QemResult::face_map},
    Field{"max_error", &QemResult::max_error},
    Field{"distance_bound", &QemResult::distance_bound},
    Field{"stop", &QemResult::stop},
    Field{"message", &QemResult::message},
    Field{"off_seam_collapses", &QemResult::off_seam_collapses},
    Field{"locked_vertices", &QemResult::locked_vertices},
    Field{"dropped_faces", &QemResult::dropped_faces},
    Field{"clamped_costs", &QemResult::clamped_costs},
};

constexpr std::tuple kQemOptions{
    Field{"target_faces", &QemOptions::target_faces},
    Field{"max_error", &QemOptions::max_error},
    Field{"max_distance", &QemOptions::max_distance},
    Field{"boundary", &QemOptions::boundary},
    Field{"boundary_weight", &QemOptions::boundary_weight},
    Field{"curvature", &QemOptions::curvature},
    Field{"texture", &QemOptions::texture},
    Field{"seam_weight", &QemOptions::seam_weight},
    Field{"complex_vertices", &QemOptions::complex_vertices},
    Field{"link_condition", &QemOptions::link_condition},
    Field{"quality_threshold", &QemOptions::quality_threshold},
};

Fields to_fields(CleanResult&& result, const py::object& source) {
  py::object mesh = mesh_to_python(std::move(result.mesh), source);
  Fields fields = to_fields(std::move(result), kCleanFields);
  fields["mesh"] = std::move(mesh);
  return fields;
}

void bind_clean(py::module_& m) {
  py::native_enum<Duplicates>(m, "Duplicates", "enum.Enum")
      .value("keep", Duplicates::kKeep)
      .value("same", Duplicates::kSame)
      .value("any", Duplicates::kAny)
      .finalize();
  m.def(
      "clean",
      [](const PyMesh& mesh, bool weld, Duplicates duplicates) {
        const BorrowedMesh borrowed(mesh);
        CleanResult result;
        {
          const py::gil_scoped_release nogil;
          result = clean(borrowed.view(), {weld, duplicates}, interruptible());
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
    const Collapse& collapse = collapses[i];
    arrays.vertices.row(i) << collapse.removed, collapse.kept;
    arrays.errors(i) = collapse.error;
  }
  return arrays;
}

Counts rejections(const std::array<std::int64_t, kNumRejections>& counts) {
  Counts rejected;
  for (std::size_t i = 0; i < counts.size(); ++i) {
    if (counts[i] > 0) rejected[kRejectionNames[i]] = counts[i];
  }
  return rejected;
}

Fields to_fields(QemResult&& r, const py::object& source) {
  CollapseArrays collapses = to_arrays(r.collapses);
  Counts rejected = rejections(r.rejected);
  py::object mesh = mesh_to_python(std::move(r.mesh), source);
  Fields result = to_fields(std::move(r), kQemFields);
  result["mesh"] = std::move(mesh);
  result["collapses"] = to_numpy(std::move(collapses.vertices));
  result["collapse_errors"] = to_numpy(std::move(collapses.errors));
  result["rejected"] = std::move(rejected);
  return result;
}

Fields to_fields(QualityResult&& r, const py::object& source) {
  Fields result;
  result["mesh"] = mesh_to_python(std::move(r.mesh), source);
  result["vertex_map"] = to_numpy(std::move(r.vertex_map));
  result["face_map"] = to_numpy(std::move(r.face_map));
  result["max_error"] = r.max_error;
  result["stop"] = r.stop;
  result["rejected"] = rejections(r.rejected);
  result["removed_pieces"] = r.removed_pieces;
  result["relaxed_collapses"] = r.relaxed_collapses;
  result["dropped_faces"] = r.dropped_faces;
  result["distance_bound"] = r.distance_bound;
  return result;
}

void bind_options(py::module_& m) {
  py::native_enum<BoundaryTerm>(m, "BoundaryTerm", "enum.Enum")
      .value("NONE", BoundaryTerm::kNone)
      .value("FREEZE", BoundaryTerm::kFreeze)
      .value("WEIGHT", BoundaryTerm::kWeight)
      .value("CURVATURE", BoundaryTerm::kCurvature)
      .finalize();
  py::native_enum<BoundaryCurvature>(m, "BoundaryCurvature", "enum.Enum")
      .value("TURNING", BoundaryCurvature::kTurning)
      .value("PAPER", BoundaryCurvature::kPaper)
      .finalize();
  py::native_enum<TextureTerm>(m, "TextureTerm", "enum.Enum")
      .value("NONE", TextureTerm::kNone)
      .value("QUADRIC5", TextureTerm::kQuadric5)
      .value("SEAM_PLANES", TextureTerm::kSeamPlanes)
      .value("SEAM_PAPER", TextureTerm::kSeamPaper)
      .value("SEAM_LOCK", TextureTerm::kSeamLock)
      .finalize();
  py::native_enum<LinkCondition>(m, "LinkCondition", "enum.Enum")
      .value("MANIFOLD", LinkCondition::kManifold)
      .value("ALWAYS", LinkCondition::kAlways)
      .value("NEVER", LinkCondition::kNever)
      .finalize();
  py::native_enum<ComplexVertices>(m, "ComplexVertices", "enum.Enum")
      .value("KEEP", ComplexVertices::kKeep)
      .value("FREEZE", ComplexVertices::kFreeze)
      .finalize();
  py::native_enum<CollapseStop>(m, "CollapseStop", "enum.Enum")
      .value("TARGET_REACHED", CollapseStop::kTargetReached)
      .value("ERROR_LIMIT", CollapseStop::kErrorLimit)
      .value("DISTANCE_LIMIT", CollapseStop::kDistanceLimit)
      .value("NO_LEGAL_COLLAPSE", CollapseStop::kNoLegalCollapse)
      .value("REFUSED", CollapseStop::kRefused)
      .finalize();
  py::class_<QemOptions> options(m, "QemOptions");
  options.def(py::init<>());
  bind_fields(options, kQemOptions);
}

void bind_qem(py::module_& m) {
  bind_options(m);
  m.def(
      "simplify_qem",
      [](const PyMesh& mesh, const QemOptions& options, const PyProgress& progress) {
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
      [](const PyMesh& mesh, const CArray<std::int32_t>& collapses) {
        const BorrowedMesh borrowed(mesh);
        const auto vertices = rows<Rows<std::int32_t, 2>>(collapses, "collapses");
        std::vector<std::pair<std::int32_t, std::int32_t>> record;
        for (Eigen::Index i = 0; i < vertices.rows(); ++i) {
          record.emplace_back(vertices(i, 0), vertices(i, 1));
        }
        std::vector<std::int64_t> left;
        {
          const py::gil_scoped_release nogil;
          left = faces_left(borrowed.view(), record, interruptible());
        }
        return to_numpy(std::move(left));
      },
      py::arg("mesh"), py::arg("collapses").noconvert());
  m.def(
      "replay_collapses",
      [](const PyMesh& mesh, const QemOptions& options, const CArray<std::int32_t>& collapses,
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
          result =
              replay_collapses(borrowed.view(), options, record, target_faces, interruptible());
        }
        return to_fields(std::move(result), mesh);
      },
      py::arg("mesh"), py::arg("options"), py::arg("collapses").noconvert(),
      py::arg("collapse_errors").noconvert(), py::arg("target_faces"));
}

void bind_quality(py::module_& m) {
  py::class_<QualityOptions>(m, "QualityOptions")
      .def(py::init<>())
      .def_readwrite("target_faces", &QualityOptions::target_faces)
      .def_readwrite("max_error", &QualityOptions::max_error)
      .def_readwrite("max_distance", &QualityOptions::max_distance)
      .def_readwrite("boundary_weight", &QualityOptions::boundary_weight)
      .def_readwrite("seam_weight", &QualityOptions::seam_weight)
      .def_readwrite("texture_weight", &QualityOptions::texture_weight)
      .def_readwrite("texture_seen", &QualityOptions::texture_seen)
      .def_readwrite("color_weight", &QualityOptions::color_weight)
      .def_readwrite("locked", &QualityOptions::locked)
      .def_readwrite("importance", &QualityOptions::importance)
      .def_readwrite("looks", &QualityOptions::looks);
  m.def(
      "simplify_quality",
      [](const PyMesh& mesh, const QualityOptions& options, const PyProgress& progress) {
        const BorrowedMesh borrowed(mesh);
        QualityResult result;
        const Progress report = interruptible(progress);
        {
          const py::gil_scoped_release nogil;
          result = simplify_quality(borrowed.view(), options, report);
        }
        return to_fields(std::move(result), mesh);
      },
      py::arg("mesh"), py::arg("options"), py::arg("progress") = py::none());
}

void bind_fast(py::module_& m) {
  py::class_<FastOptions>(m, "FastOptions")
      .def(py::init<>())
      .def_readwrite("target_faces", &FastOptions::target_faces)
      .def_readwrite("max_error", &FastOptions::max_error)
      .def_readwrite("boundary_weight", &FastOptions::boundary_weight)
      .def_readwrite("seam_weight", &FastOptions::seam_weight)
      .def_readwrite("color_weight", &FastOptions::color_weight)
      .def_readwrite("locked", &FastOptions::locked)
      .def_readwrite("looks", &FastOptions::looks)
      .def_readwrite("num_threads", &FastOptions::num_threads);
  m.def(
      "simplify_fast",
      [](const PyMesh& mesh, const FastOptions& options, const PyProgress& progress) {
        const BorrowedMesh borrowed(mesh);
        QualityResult result;
        const Progress report = interruptible(progress);
        {
          const py::gil_scoped_release nogil;
          result = simplify_fast(borrowed.view(), options, report);
        }
        return to_fields(std::move(result), mesh);
      },
      py::arg("mesh"), py::arg("options"), py::arg("progress") = py::none());
}

}  // namespace

void bind_simplify(py::module_& m) {
  bind_clean(m);
  bind_qem(m);
  bind_quality(m);
  bind_fast(m);
}

}  // namespace manip3d::bindings
