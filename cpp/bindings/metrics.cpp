#include "interruptible.hpp"
#include "manip3d/geometry/bvh.hpp"
#include "manip3d/metrics/metro.hpp"
#include "mesh.hpp"
#include "modules.hpp"

namespace manip3d::bindings {
namespace {

py::tuple to_python(const Deviation& d) { return py::make_tuple(d.mean, d.rms, d.max, d.samples); }

}  // namespace

void bind_metrics(py::module_& m) {
  m.def(
      "closest_points",
      [](const py::object& mesh, const CArray<double>& points, int threads,
         const py::object& progress) {
        const BorrowedMesh borrowed(mesh);
        const auto queries = rows<Vertices>(points, "points");
        const Progress report = interruptible(progress);
        ClosestPoints result;
        {
          const py::gil_scoped_release nogil;
          result = closest_points(borrowed.view(), queries, threads, report);
        }
        return py::make_tuple(to_numpy(std::move(result.distances)),
                              to_numpy(std::move(result.faces)),
                              to_numpy(std::move(result.points)));
      },
      py::arg("mesh"), py::arg("points").noconvert(), py::arg("threads"), py::arg("progress"));
  m.def(
      "metro",
      [](const py::object& original, const py::object& simplified, bool area, std::int64_t samples,
         std::uint64_t seed, int threads, const py::object& progress) {
        const BorrowedMesh a(original);
        const BorrowedMesh b(simplified);
        const MetroOptions options{area ? Sampling::kArea : Sampling::kVertex, samples, seed,
                                   threads};
        const Progress report = interruptible(progress);
        MetroResult result;
        {
          const py::gil_scoped_release nogil;
          result = metro(a.view(), b.view(), options, report);
        }
        return py::make_tuple(to_python(result.forward), to_python(result.backward),
                              result.diagonal);
      },
      py::arg("original"), py::arg("simplified"), py::arg("area"), py::arg("samples"),
      py::arg("seed"), py::arg("threads"), py::arg("progress"));
}

}  // namespace manip3d::bindings
