#include "depth.hpp"

#include <pybind11/native_enum.h>
#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <algorithm>
#include <array>
#include <numeric>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "exclusive.hpp"
#include "interruptible.hpp"
#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/geometry/grid_mesh.hpp"
#include "manip3d/geometry/line_of_sight.hpp"
#include "manip3d/geometry/range_image.hpp"
#include "manip3d/simplify/cs3.hpp"
#include "manip3d/simplify/grid_delaunay.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "python_types.hpp"

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
  result.color = to_intrinsics(registration.attr("color"), no_rays);
  const auto rotation = registration.attr("rotation").cast<CArray<double>>();
  const auto translation = registration.attr("translation").cast<CArray<double>>();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) result.rotation(i, j) = rotation.at(i, j);
    result.translation(i) = translation.at(i);
  }
  return result;
}

namespace {

/// A `manip3d.Registration`, or None.
class OptionalRegistration {
 public:
  explicit OptionalRegistration(const py::object& registration) {
    if (!registration.is_none()) registration_ = to_registration(registration);
  }
  [[nodiscard]] const Registration* get() const {
    return registration_ ? &*registration_ : nullptr;
  }

 private:
  std::optional<Registration> registration_;
};

Fields to_fields(DepthMesh&& mesh) {
  Fields fields;
  fields["vertices"] = to_numpy(std::move(mesh.vertices));
  fields["pixels"] = to_numpy(std::move(mesh.pixels));
  fields["texcoords"] = to_numpy(std::move(mesh.texcoords));
  fields["faces"] = to_numpy(std::move(mesh.faces));
  return fields;
}

using MeshArrays = Named<"manip3d.simplify._depth._Buffers">;

/// The caller's arrays, to which the result is written.
struct OutputArrays {
  py::array_t<float> vertices, texcoords;
  py::array_t<std::int32_t> pixels, faces;
  DepthMeshBuffers buffers;

  explicit OutputArrays(const py::object& out)
      : vertices(take<float>(out, "vertices", 3)),
        texcoords(take<float>(out, "texcoords", 2)),
        pixels(take<std::int32_t>(out, "pixels", 2)),
        faces(take<std::int32_t>(out, "faces", 3)) {
    const py::ssize_t capacity =
        std::min({vertices.shape(0), texcoords.shape(0), pixels.shape(0), faces.shape(0) / 2});
    buffers = {capacity, vertices.mutable_data(), pixels.mutable_data(), texcoords.mutable_data(),
               faces.mutable_data()};
  }

 private:
  template <typename T>
  static py::array_t<T> take(const py::object& out, const char* name, py::ssize_t columns) {
    const py::object array = out.attr(name);
    if (!py::isinstance<CArray<T>>(array) || py::reinterpret_borrow<py::array>(array).ndim() != 2 ||
        py::reinterpret_borrow<py::array>(array).shape(1) != columns ||
        !py::reinterpret_borrow<py::array>(array).writeable()) {
      throw InputError(std::string("out.") + name + ": expected a writable C-contiguous (N, " +
                       std::to_string(columns) + ") array of " +
                       (std::is_same_v<T, float> ? "float32" : "int32"));
    }
    return py::reinterpret_borrow<py::array_t<T>>(array);
  }
};

Fields to_fields(const Cs3Report& report) {
  py::typing::Dict<py::str, double> timings;
  for (std::size_t i = 0; i < report.seconds.size(); ++i) {
    timings[kCs3StageNames[i]] = report.seconds[i];
  }
  Fields fields;
  fields["num_vertices"] = report.num_vertices;
  fields["num_faces"] = report.num_faces;
  fields["reached"] = report.reached;
  fields["factor"] = report.factor;
  fields["literal_count"] = py::cast(report.literal_count);
  fields["passes"] = report.passes;
  fields["timings"] = timings;
  return fields;
}

/// A Cs3 with the rays of its latest camera. It processes one frame at a time.
class Cs3Runner {
 public:
  Fields run_depth(const py::array& depth, const PyIntrinsics& camera, const Cs3Options& options,
                   const OptionalPyRegistration& registration, const MeshArrays& out) {
    const DepthView view = depth_view(depth);
    if (!camera.is(camera_)) {
      py::object keep;
      rays_ = PixelRays(to_intrinsics(camera, keep));
      camera_ = camera;
    }
    return run(RangeImage(view, rays_), options, registration, out);
  }

  Fields run_grid(const CArray<float>& points, const CArray<bool>& valid, bool rows_up,
                  const Cs3Options& options, const MeshArrays& out) {
    const BorrowedGrid grid(points, valid, rows_up);
    return run(RangeImage(grid.view), options, py::none(), out);
  }

 private:
  Fields run(const RangeImage& image, const Cs3Options& options,
             const OptionalPyRegistration& registration, const MeshArrays& out) {
    OutputArrays arrays(out);
    const OptionalRegistration color(registration);
    Cs3Report report;
    {
      const py::gil_scoped_release nogil;
      report = cs3_.run(image, options, color.get(), arrays.buffers);
    }
    return to_fields(report);
  }

  Cs3 cs3_;
  PixelRays rays_;
  /// Camera of rays_, which is compared by identity because intrinsics do not change.
  py::object camera_ = py::none();
};

void bind_cs3(py::module_& m) {
  py::native_enum<Cs3Importance>(m, "Cs3Importance", "enum.Enum")
      .value("LAPLACIAN", Cs3Importance::kLaplacian)
      .value("MIN_CURVATURE", Cs3Importance::kMinCurvature)
      .finalize();
  py::native_enum<Cs3Sampling>(m, "Cs3Sampling", "enum.Enum")
      .value("NON_MAXIMUM", Cs3Sampling::kNonMaximum)
      .value("IMPORTANCE_ORDER", Cs3Sampling::kImportanceOrder)
      .finalize();
  py::native_enum<Cs3Reading::Stencil>(m, "Cs3Stencil", "enum.Enum")
      .value("GRADIENT_OF_GRADIENT", Cs3Reading::Stencil::kGradientOfGradient)
      .value("COMPACT", Cs3Reading::Stencil::kCompact)
      .value("FORWARD", Cs3Reading::Stencil::kForward)
      .value("SOBEL", Cs3Reading::Stencil::kSobel)
      .finalize();
  py::native_enum<Cs3Reading::BesideInvalid>(m, "Cs3BesideInvalid", "enum.Enum")
      .value("BACKWARD", Cs3Reading::BesideInvalid::kBackward)
      .value("ZERO", Cs3Reading::BesideInvalid::kZero)
      .value("UNKNOWN", Cs3Reading::BesideInvalid::kUnknown)
      .finalize();
  py::native_enum<Cs3Reading::Rounding>(m, "Cs3Rounding", "enum.Enum")
      .value("DOWN", Cs3Reading::Rounding::kDown)
      .value("NEAREST", Cs3Reading::Rounding::kNearest)
      .value("UP", Cs3Reading::Rounding::kUp)
      .finalize();
  py::native_enum<Cs3Reached>(m, "Cs3Reached", "enum.Enum")
      .value("FACTOR", Cs3Reached::kFactor)
      .value("CUT", Cs3Reached::kCut)
      .value("CONTINUED", Cs3Reached::kContinued)
      .value("ALL_PIXELS", Cs3Reached::kAllPixels)
      .finalize();
  py::class_<Cs3Reading>(m, "Cs3Reading")
      .def(py::init<>())
      .def_readwrite("stencil", &Cs3Reading::stencil)
      .def_readwrite("beside_invalid", &Cs3Reading::beside_invalid)
      .def_readwrite("rounding", &Cs3Reading::rounding)
      .def_readwrite("outliers", &Cs3Reading::outliers);
  py::class_<Cs3Options>(m, "Cs3Options")
      .def(py::init<>())
      .def_readwrite("target_points", &Cs3Options::target_points)
      .def_readwrite("importance", &Cs3Options::importance)
      .def_readwrite("sampling", &Cs3Options::sampling)
      .def_readwrite("distance_dependent", &Cs3Options::distance_dependent)
      .def_readwrite("max_edge", &Cs3Options::max_edge)
      .def_readwrite("num_threads", &Cs3Options::num_threads)
      .def_readwrite("reading", &Cs3Options::reading);
  py::class_<Exclusive<Cs3Runner>>(m, "Cs3Runner")
      .def(py::init<>())
      .def("run_depth", exclusively(&Cs3Runner::run_depth), py::arg("depth"), py::arg("camera"),
           py::arg("options"), py::arg("registration"), py::arg("out"))
      .def("run_grid", exclusively(&Cs3Runner::run_grid), py::arg("points").noconvert(),
           py::arg("valid").noconvert(), py::arg("rows_up"), py::arg("options"), py::arg("out"));
}

// Edges between rows as edges between the places that the rows have in `order`.
std::vector<std::array<std::int32_t, 2>> in_order(
    const Eigen::Map<const Rows<std::int32_t, 2>>& edges, const std::vector<std::int32_t>& order) {
  std::vector<std::int32_t> place(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) place[order[i]] = static_cast<std::int32_t>(i);
  std::vector<std::array<std::int32_t, 2>> ordered(edges.rows());
  for (Eigen::Index i = 0; i < edges.rows(); ++i) {
    for (int k = 0; k < 2; ++k) ordered[i][k] = place.at(edges(i, k));
  }
  return ordered;
}

/// Triangulates pixels in any order; vertices are numbered in this order.
Faces triangulate(const Eigen::Map<const Rows<std::int32_t, 2>>& rows,
                  const Eigen::Map<const Rows<std::int32_t, 2>>& edges) {
  std::vector<std::int32_t> order(rows.rows());
  std::iota(order.begin(), order.end(), 0);
  const auto at = [&](std::int32_t i) { return Pixel{rows(i, 0), rows(i, 1)}; };
  std::sort(order.begin(), order.end(),
            [&](std::int32_t a, std::int32_t b) { return at(a) < at(b); });
  std::vector<Pixel> pixels(order.size());
  std::transform(order.begin(), order.end(), pixels.begin(), at);
  GridDelaunay delaunay;
  delaunay.triangulate(pixels);
  delaunay.constrain(in_order(edges, order));
  Faces faces(delaunay.num_faces(), 3);
  for (std::int32_t t = 0; t < delaunay.num_faces(); ++t) {
    const auto corners = delaunay.triangle(t);
    for (int i = 0; i < 3; ++i) {
      faces(t, i) = order[corners[i]];
    }
  }
  return faces;
}

}  // namespace

void bind_depth(py::module_& m) {
  bind_cs3(m);
  m.def(
      "check_intrinsics",
      [](const PyIntrinsics& camera) {
        py::object rays;
        check_intrinsics(to_intrinsics(camera, rays));
      },
      py::arg("camera"));
  m.def(
      "check_registration",
      [](const PyRegistration& registration) { check_registration(to_registration(registration)); },
      py::arg("registration"));
  m.def(
      "unproject",
      [](const py::array& depth, const PyIntrinsics& camera, int threads) {
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
      "unproject_pixels",
      [](const CArray<double>& pixels, const CArray<double>& depth, const PyIntrinsics& camera) {
        const auto uv = rows<Rows<double, 2>>(pixels, "pixels");
        const auto z = rows<Eigen::VectorXd>(depth, "depth");
        if (z.size() != uv.rows()) throw InputError("depth: expected one number per pixel");
        py::object rays;
        const Intrinsics intrinsics = to_intrinsics(camera, rays);
        Rows<double, 3> points(uv.rows(), 3);
        {
          const py::gil_scoped_release nogil;
          for (Eigen::Index i = 0; i < points.rows(); ++i) {
            const Eigen::Vector2d sight = line_of_sight(intrinsics, uv.row(i).transpose());
            points.row(i) << z(i) * sight.x(), z(i) * sight.y(), z(i);
          }
        }
        return to_numpy(std::move(points));
      },
      py::arg("pixels").noconvert(), py::arg("depth").noconvert(), py::arg("camera"));
  m.def(
      "project",
      [](const CArray<double>& points, const PyIntrinsics& camera) {
        const auto xyz = rows<Rows<double, 3>>(points, "points");
        py::object rays;
        const Intrinsics intrinsics = to_intrinsics(camera, rays);
        Rows<double, 2> pixels(xyz.rows(), 2);
        {
          const py::gil_scoped_release nogil;
          for (Eigen::Index i = 0; i < pixels.rows(); ++i) {
            pixels.row(i) = pixel_of(intrinsics, xyz.row(i).transpose()).transpose();
          }
        }
        return to_numpy(std::move(pixels));
      },
      py::arg("points").noconvert(), py::arg("camera"));
  m.def(
      "grid_mesh",
      [](const CArray<float>& points, const CArray<bool>& valid, bool rows_up, double max_edge,
         const OptionalPyRegistration& registration, int threads) {
        const BorrowedGrid grid(points, valid, rows_up);
        const OptionalRegistration camera(registration);
        DepthMesh mesh;
        {
          const py::gil_scoped_release nogil;
          mesh = grid_mesh(grid.view, {max_edge, threads}, camera.get());
        }
        return to_fields(std::move(mesh));
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("rows_up"),
      py::arg("max_edge"), py::arg("registration"), py::arg("threads"));
  m.def(
      "registered_texcoords",
      [](const CArray<float>& vertices, const PyRegistration& registration) {
        const auto points = rows<Rows<float, 3>>(vertices, "vertices");
        const Registration camera = to_registration(registration);
        Rows<float, 2> texcoords(points.rows(), 2);
        {
          const py::gil_scoped_release nogil;
          for (Eigen::Index i = 0; i < points.rows(); ++i) {
            const auto uv = registered_texcoord({points(i, 0), points(i, 1), points(i, 2)}, camera);
            texcoords.row(i) << uv[0], uv[1];
          }
        }
        return to_numpy(std::move(texcoords));
      },
      py::arg("vertices").noconvert(), py::arg("registration"));
  m.def(
      "grid_delaunay",
      [](const CArray<std::int32_t>& pixels, const CArray<std::int32_t>& edges) {
        const auto view = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
        const auto ends = rows<Rows<std::int32_t, 2>>(edges, "edges");
        Faces faces;
        {
          const py::gil_scoped_release nogil;
          faces = triangulate(view, ends);
        }
        return to_numpy(std::move(faces));
      },
      py::arg("pixels").noconvert(), py::arg("edges").noconvert());
}

}  // namespace manip3d::bindings
