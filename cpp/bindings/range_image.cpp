#include "manip3d/metrics/range_image.hpp"

#include "depth.hpp"
#include "interruptible.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

/// The lines of sight of a `manip3d.Intrinsics`; None: lines of sight fitted to the grid.
RangeCamera to_range_camera(const OptionalPyIntrinsics& intrinsics, const PointGridView& grid) {
  if (intrinsics.is_none()) return fit_range_camera(grid);
  py::object rays;
  return pinhole_range_camera(to_intrinsics(intrinsics, rays));
}

}  // namespace

void bind_range_image(py::module_& m) {
  m.def(
      "render_depth",
      [](const PyMesh& mesh, const CArray<float>& points, const CArray<bool>& valid, bool rows_up,
         const OptionalPyIntrinsics& intrinsics, int threads, const PyProgress& progress) {
        const BorrowedMesh borrowed(mesh);
        const BorrowedGrid grid(points, valid, rows_up);
        const RangeCamera camera = to_range_camera(intrinsics, grid.view);
        const Progress report = interruptible(progress);
        std::vector<double> depth;
        {
          const py::gil_scoped_release nogil;
          depth = render_depth(borrowed.view(), grid.view, camera, {threads}, report);
        }
        return to_numpy(std::move(depth));
      },
      py::arg("mesh"), py::arg("points").noconvert(), py::arg("valid").noconvert(),
      py::arg("rows_up"), py::arg("intrinsics"), py::arg("threads"), py::arg("progress"));
  m.def(
      "range_image_error",
      [](const PyMesh& mesh, const CArray<float>& points, const CArray<bool>& valid, bool rows_up,
         const OptionalPyIntrinsics& intrinsics, int threads, const PyProgress& progress) {
        const BorrowedMesh borrowed(mesh);
        const BorrowedGrid grid(points, valid, rows_up);
        const RangeCamera camera = to_range_camera(intrinsics, grid.view);
        const Progress report = interruptible(progress);
        RangeImageError e;
        {
          const py::gil_scoped_release nogil;
          e = range_image_error(borrowed.view(), grid.view, camera, {threads}, report);
        }
        return py::make_tuple(e.mean_square, e.mean_absolute, e.max, e.diagonal, e.compared,
                              e.valid);
      },
      py::arg("mesh"), py::arg("points").noconvert(), py::arg("valid").noconvert(),
      py::arg("rows_up"), py::arg("intrinsics"), py::arg("threads"), py::arg("progress"));
}

}  // namespace manip3d::bindings
