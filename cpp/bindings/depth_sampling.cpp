#include "manip3d/simplify/depth_sampling.hpp"

#include "depth.hpp"
#include "modules.hpp"

namespace manip3d::bindings {
namespace {

py::array pixel_rows(const std::vector<Pixel>& pixels) {
  Rows<std::int32_t, 2> rows(static_cast<Eigen::Index>(pixels.size()), 2);
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    rows(i, 0) = pixels[i].u;
    rows(i, 1) = pixels[i].v;
  }
  return to_numpy(std::move(rows));
}

}  // namespace

void bind_depth_sampling(py::module_& m) {
  m.def(
      "sample_uniform",
      [](const CArray<float>& points, const CArray<bool>& valid, std::int64_t target_points) {
        const BorrowedGrid grid(points, valid, false);
        std::vector<Pixel> pixels;
        {
          const py::gil_scoped_release nogil;
          pixels = sample_uniform(grid.view, target_points);
        }
        return pixel_rows(pixels);
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("target_points"));
  m.def(
      "sample_poisson_disk",
      [](const CArray<float>& points, const CArray<bool>& valid, std::int64_t target_points,
         std::uint64_t seed) {
        const BorrowedGrid grid(points, valid, false);
        PoissonDiskSample sample;
        {
          const py::gil_scoped_release nogil;
          sample = sample_poisson_disk(grid.view, target_points, seed);
        }
        return py::make_tuple(pixel_rows(sample.pixels), sample.radius);
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("target_points"),
      py::arg("seed"));
  m.def(
      "sample_scale_space",
      [](const CArray<float>& points, const CArray<bool>& valid, std::int64_t target_points) {
        const BorrowedGrid grid(points, valid, false);
        ScaleSpaceSample sample;
        {
          const py::gil_scoped_release nogil;
          sample = sample_scale_space(grid.view, target_points);
        }
        return py::make_tuple(pixel_rows(sample.pixels), sample.sigma);
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("target_points"));
}

}  // namespace manip3d::bindings
