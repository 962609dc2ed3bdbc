#include "depth.hpp"

#include <pybind11/typing.h>

#include <algorithm>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include "interruptible.hpp"
#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/grid_mesh.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"
#include "modules.hpp"
#include "numpy.hpp"

namespace manip3d::bindings {

Intrinsics to_intrinsics(const py::object& camera, py::object& keep) {
  Intrinsics result;
  result.width = camera.attr("width").cast<std::int64_t>();
  result.height = camera.attr("height").cast<std::int64_t>();
  result.fx = camera.attr("fx").cast<double>();
  result.fy = camera.attr("fy").cast<double>();
  result.cx = camera.attr("cx").cast<double>();
  result.cy = camera.attr("cy").cast<double>();
  result.distortion = {};
  std::size_t i = 0;
  for (const py::handle k : camera.attr("distortion")) {
    result.distortion.at(i++) = k.cast<double>();
  }
  result.mirrored = camera.attr("mirrored").cast<bool>();
  keep = camera.attr("rays");
  if (!keep.is_none()) result.ray_table = keep.cast<CArray<float>>().data();
  return result;
}

namespace {

using Fields = py::typing::Dict<py::str, py::object>;

DepthView depth_view(const py::array& depth) {
  DepthView view;
  if (py::isinstance<CArray<std::uint16_t>>(depth)) {
    view.millimetres = static_cast<const std::uint16_t*>(depth.data());
  } else if (py::isinstance<CArray<float>>(depth)) {
    view.metres = static_cast<const float*>(depth.data());
  }
  if (depth.ndim() != 2 || (view.millimetres == nullptr && view.metres == nullptr)) {
    throw InputError("depth: expected (H, W) uint16 or float32, C-contiguous");
  }
  view.rows = depth.shape(0);
  view.cols = depth.shape(1);
  return view;
}

Registration to_registration(const py::object& registration) {
  Registration result;
  py::object no_rays;
  result.colour = to_intrinsics(registration.attr("colour"), no_rays);
  const auto rotation = registration.attr("rotation").cast<CArray<double>>();
  const auto translation = registration.attr("translation").cast<CArray<double>>();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) result.rotation(i, j) = rotation.at(i, j);
    result.translation(i) = translation.at(i);
  }
  return result;
}

Fields to_fields(DepthMesh&& mesh) {
  Fields fields;
  fields["vertices"] = to_numpy(std::move(mesh.vertices));
  fields["pixels"] = to_numpy(std::move(mesh.pixels));
  fields["uvs"] = to_numpy(std::move(mesh.uvs));
  fields["triangles"] = to_numpy(std::move(mesh.triangles));
  return fields;
}

/// The triangulation of pixels in any order, numbered as they came.
Faces triangulate(const Eigen::Map<const Rows<std::int32_t, 2>>& rows) {
  std::vector<std::int32_t> order(static_cast<std::size_t>(rows.rows()));
  std::iota(order.begin(), order.end(), 0);
  const auto at = [&](std::int32_t i) { return Pixel{rows(i, 0), rows(i, 1)}; };
  std::sort(order.begin(), order.end(),
            [&](std::int32_t a, std::int32_t b) { return at(a) < at(b); });
  std::vector<Pixel> pixels(order.size());
  std::transform(order.begin(), order.end(), pixels.begin(), at);
  GridDelaunay delaunay;
  delaunay.triangulate(pixels);
  Faces triangles(delaunay.num_triangles(), 3);
  for (std::int32_t t = 0; t < delaunay.num_triangles(); ++t) {
    const auto corners = delaunay.triangle(t);
    for (int i = 0; i < 3; ++i) {
      triangles(t, i) = order[static_cast<std::size_t>(corners[static_cast<std::size_t>(i)])];
    }
  }
  return triangles;
}

}  // namespace

void bind_depth(py::module_& m) {
  m.def(
      "check_intrinsics",
      [](const py::object& camera) {
        py::object rays;
        check_intrinsics(to_intrinsics(camera, rays));
      },
      py::arg("camera"));
  m.def(
      "check_registration",
      [](const py::object& registration) { check_registration(to_registration(registration)); },
      py::arg("registration"));
  m.def(
      "unproject",
      [](const py::array& depth, const py::object& camera, int threads) {
        const DepthView view = depth_view(depth);
        py::object rays;
        const Intrinsics intrinsics = to_intrinsics(camera, rays);
        PointGrid grid;
        {
          const py::gil_scoped_release nogil;
          grid = unproject(view, PixelRays(intrinsics), threads);
        }
        const bool rows_up = grid.rows_up;
        return py::make_tuple(to_numpy(std::move(grid.points)), to_numpy(std::move(grid.valid)),
                              rows_up);
      },
      py::arg("depth"), py::arg("camera"), py::arg("threads"));
  m.def(
      "grid_mesh",
      [](const CArray<float>& points, const CArray<bool>& valid, bool rows_up, double max_edge,
         int threads) {
        const BorrowedGrid grid(points, valid, rows_up);
        DepthMesh mesh;
        {
          const py::gil_scoped_release nogil;
          mesh = grid_mesh(grid.view, {max_edge, threads});
        }
        return to_fields(std::move(mesh));
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("rows_up"),
      py::arg("max_edge"), py::arg("threads"));
  m.def(
      "registered_uvs",
      [](const CArray<float>& vertices, const py::object& registration) {
        const Rows<float, 3> points = rows<Rows<float, 3>>(vertices, "vertices");
        const Registration camera = to_registration(registration);
        Rows<float, 2> uvs;
        {
          const py::gil_scoped_release nogil;
          registered_uvs(points, camera, uvs);
        }
        return to_numpy(std::move(uvs));
      },
      py::arg("vertices").noconvert(), py::arg("registration"));
  m.def(
      "grid_delaunay",
      [](const CArray<std::int32_t>& pixels) {
        const auto view = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
        Faces triangles;
        {
          const py::gil_scoped_release nogil;
          triangles = triangulate(view);
        }
        return to_numpy(std::move(triangles));
      },
      py::arg("pixels").noconvert());
}

}  // namespace manip3d::bindings
