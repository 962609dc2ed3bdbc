#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <string>

#include "interruptible.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/geometry/nearest_neighbours.hpp"
#include "manip3d/geometry/shading.hpp"
#include "manip3d/geometry/sparse_points.hpp"
#include "manip3d/geometry/summary.hpp"
#include "manip3d/geometry/topology.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "points.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

using TwoArrays = py::typing::Tuple<py::array, py::array>;

py::array corners(const BoundingBox& box) {
  Vertices rows(2, 3);
  rows << box.min.transpose(), box.max.transpose();
  return to_numpy(std::move(rows));
}

void add_counts(Fields& fields, const TopologyCounts& counts, const std::string& suffix) {
  const auto set = [&](const char* name, std::int64_t value) {
    fields[py::str(name + suffix)] = value;
  };
  set("vertices", counts.vertices);
  set("edges", counts.edges);
  set("boundary_edges", counts.boundary_edges);
  set("non_manifold_edges", counts.non_manifold_edges);
  set("complex_vertices", counts.complex_vertices);
  set("degenerate_faces", counts.degenerate_faces);
  set("duplicate_faces", counts.duplicate_faces);
  set("components", counts.components);
}

Fields to_fields(const MeshSummary& summary) {
  Fields fields;
  add_counts(fields, summary.stored, "");
  add_counts(fields, summary.welded, "_welded");
  fields["faces"] = summary.faces;
  fields["texcoords"] = summary.texcoords;
  fields["unreferenced_vertices"] = summary.unreferenced_vertices;
  fields["zero_area_faces"] = summary.zero_area_faces;
  fields["materials_used"] = summary.materials_used;
  fields["faces_without_uv"] = summary.faces_without_texcoords;
  fields["multi_uv_vertices"] = summary.multi_uv_vertices;
  fields["closed"] = summary.closed;
  fields["has_normals"] = summary.has_normals;
  fields["has_colors"] = summary.has_colors;
  fields["bounds"] = corners(summary.bounding_box);
  return fields;
}

}  // namespace

void bind_geometry(py::module_& m) {
  m.def(
      "check_mesh",
      [](const PyMesh& mesh) {
        const BorrowedMesh borrowed(mesh);
        const py::gil_scoped_release nogil;
        check_mesh(borrowed.view());
      },
      py::arg("mesh"));
  m.def(
      "bounding_box",
      [](const PyMesh& mesh) {
        const BorrowedMesh borrowed(mesh);
        check_mesh(borrowed.view());
        return corners(bounding_box(borrowed.view()));
      },
      py::arg("mesh"));
  m.def(
      "count_components",
      [](const PyMesh& mesh) {
        const BorrowedMesh borrowed(mesh);
        const py::gil_scoped_release nogil;
        check_mesh(borrowed.view());
        return find_components(borrowed.view().faces, borrowed.view().num_vertices()).count;
      },
      py::arg("mesh"));
  m.def(
      "summarize",
      [](const PyMesh& mesh) {
        const BorrowedMesh borrowed(mesh);
        MeshSummary summary;
        {
          const py::gil_scoped_release nogil;
          summary = summarize(borrowed.view());
        }
        return to_fields(summary);
      },
      py::arg("mesh"));
  m.def(
      "shading_normals",
      [](const PyMesh& mesh, double crease_angle, int threads) {
        const BorrowedMesh borrowed(mesh);
        ShadingNormals shading;
        {
          const py::gil_scoped_release nogil;
          shading = shading_normals(borrowed.view(), crease_angle, threads);
        }
        return TwoArrays(py::make_tuple(to_numpy(std::move(shading.normals)),
                                        to_numpy(std::move(shading.face_normals))));
      },
      py::arg("mesh"), py::arg("crease_angle"), py::arg("threads"));
  m.def(
      "welded_boundary",
      [](const PyMesh& mesh) {
        const BorrowedMesh borrowed(mesh);
        Rows<std::int32_t, 2> edges;
        {
          const py::gil_scoped_release nogil;
          edges = welded_boundary(borrowed.view());
        }
        return to_numpy(std::move(edges));
      },
      py::arg("mesh"));
  m.def(
      "nearest_distances",
      [](const CArray<float>& points, const std::optional<Eigen::Vector3d>& origin,
         double resolution, int threads, const PyProgress& progress) {
        const PointsView view = points_view(points, {});
        const Progress report = interruptible(progress);
        LargeArray<double> distances;
        {
          const py::gil_scoped_release nogil;
          distances = nearest_distances(view, {origin, resolution, threads}, report);
        }
        return to_numpy_rows<1>(std::move(distances));
      },
      py::arg("points").noconvert(), py::arg("origin"), py::arg("resolution"), py::arg("threads"),
      py::arg("progress"));
  m.def(
      "sparse_distances",
      [](const CArray<float>& points, int neighbours, double nearest, double angle, double farthest,
         int every) {
        const PointsView view = points_view(points, {});
        std::vector<std::vector<float>> distances;
        {
          const py::gil_scoped_release nogil;
          distances = sparse_distances(view, {neighbours, nearest, angle, farthest, every},
                                       interruptible());
        }
        std::vector<py::array_t<float>> of_neighbours;
        of_neighbours.reserve(distances.size());
        for (std::vector<float>& each : distances) {
          of_neighbours.emplace_back(to_numpy(std::move(each)));
        }
        return of_neighbours;
      },
      py::arg("points").noconvert(), py::arg("neighbours"), py::arg("nearest"), py::arg("angle"),
      py::arg("farthest"), py::arg("every"));
}

}  // namespace manip3d::bindings
