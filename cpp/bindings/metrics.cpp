#include <pybind11/stl.h>

#include "interruptible.hpp"
#include "manip3d/geometry/bvh.hpp"
#include "manip3d/metrics/boundary_gap.hpp"
#include "manip3d/metrics/color_error.hpp"
#include "manip3d/metrics/fmpd.hpp"
#include "manip3d/metrics/hausdorff.hpp"
#include "manip3d/metrics/metro.hpp"
#include "manip3d/metrics/texture_error.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

using DeviationTuple = std::tuple<double, double, double, std::int64_t>;

DeviationTuple to_python(const Deviation& d) { return {d.mean, d.rms, d.max, d.samples}; }

std::optional<DeviationTuple> to_python(const std::optional<Deviation>& d) {
  if (!d) return std::nullopt;
  return to_python(*d);
}

}  // namespace

void bind_metrics(py::module_& m) {
  m.def(
      "closest_points",
      [](const PyMesh& mesh, const CArray<double>& points, double max_distance, int threads,
         const PyProgress& progress) {
        const BorrowedMesh borrowed(mesh);
        const auto queries = rows<Vertices>(points, "points");
        const Progress report = interruptible(progress);
        ClosestPoints result;
        {
          const py::gil_scoped_release nogil;
          result = closest_points(borrowed.view(), queries, max_distance, threads, report);
        }
        return py::make_tuple(to_numpy(std::move(result.distances)),
                              to_numpy(std::move(result.faces)),
                              to_numpy(std::move(result.points)));
      },
      py::arg("mesh"), py::arg("points").noconvert(), py::arg("max_distance"), py::arg("threads"),
      py::arg("progress"));
  m.def(
      "metro",
      [](const PyMesh& original, const PyMesh& simplified, bool area, std::int64_t samples,
         std::uint64_t seed, int threads, const PyProgress& progress) {
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
  m.def(
      "hausdorff_bound",
      [](const PyMesh& original, const PyMesh& simplified, double tolerance, int threads,
         const PyProgress& progress) {
        const BorrowedMesh a(original);
        const BorrowedMesh b(simplified);
        const Progress report = interruptible(progress);
        HausdorffResult r;
        {
          const py::gil_scoped_release nogil;
          r = hausdorff_bound(a.view(), b.view(), {tolerance, threads}, report);
        }
        return py::make_tuple(std::pair(r.forward.lower, r.forward.upper),
                              std::pair(r.backward.lower, r.backward.upper), r.diagonal);
      },
      py::arg("original"), py::arg("simplified"), py::arg("tolerance"), py::arg("threads"),
      py::arg("progress"));
  m.def(
      "texture_error",
      [](const PyMesh& original, const PyMesh& simplified, std::int64_t samples, std::uint64_t seed,
         double epsilon, int threads, const PyProgress& progress) {
        const BorrowedMesh a(original);
        const BorrowedMesh b(simplified);
        const TextureErrorOptions options{samples, seed, epsilon, threads};
        const Progress report = interruptible(progress);
        TextureError e;
        {
          const py::gil_scoped_release nogil;
          e = texture_error(a.view(), b.view(), options, report);
        }
        return py::make_tuple(e.mean, e.rms, e.mse, e.max, e.samples, e.skipped,
                              e.material_mismatch_rate, e.outside_charts);
      },
      py::arg("original"), py::arg("simplified"), py::arg("samples"), py::arg("seed"),
      py::arg("epsilon"), py::arg("threads"), py::arg("progress"));
  m.def(
      "color_error",
      [](const PyMesh& original, const PyMesh& simplified, std::int64_t samples, std::uint64_t seed,
         double epsilon, int threads, const PyProgress& progress) {
        const BorrowedMesh a(original);
        const BorrowedMesh b(simplified);
        const ColorErrorOptions options{samples, seed, epsilon, threads};
        const Progress report = interruptible(progress);
        ColorError e;
        {
          const py::gil_scoped_release nogil;
          e = color_error(a.view(), b.view(), options, report);
        }
        return py::make_tuple(e.mean, e.rms, e.max, e.samples);
      },
      py::arg("original"), py::arg("simplified"), py::arg("samples"), py::arg("seed"),
      py::arg("epsilon"), py::arg("threads"), py::arg("progress"));
  m.def(
      "fmpd",
      [](const PyMesh& original, const PyMesh& simplified, bool clip, int threads,
         const PyProgress& progress) {
        const BorrowedMesh a(original);
        const BorrowedMesh b(simplified);
        const FmpdOptions options{clip, threads};
        const Progress report = interruptible(progress);
        FmpdResult r;
        {
          const py::gil_scoped_release nogil;
          r = fmpd(a.view(), b.view(), options, report);
        }
        return py::make_tuple(r.value, r.roughness_original, r.roughness_simplified,
                              r.skipped_faces, r.is_non_manifold);
      },
      py::arg("original"), py::arg("simplified"), py::arg("clip"), py::arg("threads"),
      py::arg("progress"));
  m.def(
      "boundary_gap",
      [](const PyMesh& original, const PyMesh& simplified, double tolerance, bool weld, int threads,
         const PyProgress& progress) {
        const BorrowedMesh a(original);
        const BorrowedMesh b(simplified);
        const BoundaryGapOptions options{tolerance, weld, threads};
        const Progress report = interruptible(progress);
        BoundaryGap gap;
        {
          const py::gil_scoped_release nogil;
          gap = boundary_gap(a.view(), b.view(), options, report);
        }
        return py::make_tuple(to_python(gap.forward), to_python(gap.backward), gap.cracks,
                              gap.crack_length, gap.diagonal);
      },
      py::arg("original"), py::arg("simplified"), py::arg("tolerance"), py::arg("weld"),
      py::arg("threads"), py::arg("progress"));
}

}  // namespace manip3d::bindings
