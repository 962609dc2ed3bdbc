#include "manip3d/simplify/relief.hpp"

#include <pybind11/native_enum.h>
#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <algorithm>
#include <optional>
#include <span>
#include <tuple>
#include <utility>
#include <vector>

#include "depth.hpp"
#include "exclusive.hpp"
#include "interruptible.hpp"
#include "manip3d/simplify/depth_smoother.hpp"
#include "manip3d/simplify/edge_steps.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

/// Coverage, bridges, pixels outside the surface, and the bridges over filled pixels.
std::tuple<double, double, double, double> shares_in(const DepthCoverage& cover) {
  return {cover.coverage, cover.bridges, cover.outside, cover.filled};
}

Fields to_fields(ReliefResult&& result) {
  Fields fields;
  fields["vertices"] = to_numpy(std::move(result.mesh.vertices));
  fields["pixels"] = to_numpy(std::move(result.mesh.pixels));
  fields["texcoords"] = to_numpy(std::move(result.mesh.texcoords));
  fields["faces"] = to_numpy(std::move(result.mesh.faces));
  py::list levels;
  for (ReliefLevel& level : result.levels) {
    levels.append(py::make_tuple(level.num_vertices, to_numpy(std::move(level.faces))));
  }
  fields["levels"] = py::tuple(levels);
  fields["stop"] = result.stop;
  fields["dropped_pixels"] = result.dropped_pixels;
  fields["cover"] = shares_in(result.cover);
  fields["without_off"] = shares_in(result.cover_without_off);
  fields["filled"] = to_numpy(std::move(result.filled));
  fields["unsure"] = to_numpy(std::move(result.unsure));
  fields["off"] = to_numpy(std::move(result.off));
  fields["mean_move"] = result.mean_move;
  fields["max_move"] = result.max_move;
  return fields;
}

std::span<const float> shares_of(const std::optional<CArray<float>>& confidence) {
  if (!confidence) return {};
  check_image(*confidence, 0, "confidence");
  return {confidence->data(), static_cast<std::size_t>(confidence->size())};
}

}  // namespace

void bind_relief(py::module_& m) {
  py::native_enum<ReliefEffort>(m, "ReliefEffort", "enum.Enum")
      .value("live", ReliefEffort::kLive)
      .value("fast", ReliefEffort::kFast)
      .value("balanced", ReliefEffort::kBalanced)
      .value("fine", ReliefEffort::kFine)
      .value("best", ReliefEffort::kBest)
      .finalize();
  py::native_enum<ReliefStop>(m, "ReliefStop", "enum.Enum")
      .value("target", ReliefStop::kTarget)
      .value("all_points", ReliefStop::kAllPoints)
      .value("small_pieces", ReliefStop::kSmallPieces)
      .value("few_faces", ReliefStop::kFewFaces)
      .value("fewer_points", ReliefStop::kFewerPoints)
      .value("pinholes", ReliefStop::kPinholes)
      .value("smaller_level", ReliefStop::kSmallerLevel)
      .finalize();
  py::class_<ReliefOptions>(m, "ReliefOptions")
      .def(py::init<>())
      .def_readwrite("target_points", &ReliefOptions::target_points)
      .def_readwrite("effort", &ReliefOptions::effort)
      .def_readwrite("move_points", &ReliefOptions::move_points)
      .def_readwrite("from_origin", &ReliefOptions::from_origin)
      .def_property(
          "max_edge", [](const ReliefOptions& self) { return self.dense.max_edge; },
          [](ReliefOptions& self, double value) { self.dense.max_edge = value; })
      .def_property(
          "max_step", [](const ReliefOptions& self) { return self.dense.max_step; },
          [](ReliefOptions& self, double value) { self.dense.max_step = value; })
      .def_property(
          "focal", [](const ReliefOptions& self) { return self.dense.focal; },
          [](ReliefOptions& self, double value) { self.dense.focal = value; })
      .def_readwrite("levels", &ReliefOptions::levels)
      .def_readwrite("stability", &ReliefOptions::stability)
      .def_readwrite("measure_coverage", &ReliefOptions::measure_coverage)
      .def_readwrite("num_threads", &ReliefOptions::num_threads);
  py::class_<Exclusive<Relief>>(m, "ReliefSolver")
      .def(py::init<>())
      .def("reset", exclusively(&Relief::reset))
      .def(
          "run",
          [](Exclusive<Relief>& self, const CArray<float>& points, const CArray<bool>& valid,
             bool rows_up, const ReliefOptions& options,
             const std::optional<CArray<float>>& confidence) {
            const BorrowedGrid grid(points, valid, rows_up);
            const std::span<const float> shares = shares_of(confidence);
            ReliefResult result;
            self.with([&](Relief& relief) {
              const py::gil_scoped_release nogil;
              relief.run(grid.view, options, result, shares, interruptible());
            });
            return to_fields(std::move(result));
          },
          py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("rows_up"),
          py::arg("options"), py::arg("confidence").noconvert() = py::none())
      .def(
          "run_depth",
          [](Exclusive<Relief>& self, const py::array& depth, const PyIntrinsics& camera,
             const ReliefOptions& options, const std::optional<CArray<float>>& confidence) {
            const DepthView view = depth_view(depth);
            py::object rays;
            const Intrinsics intrinsics = to_intrinsics(camera, rays);
            const std::span<const float> shares = shares_of(confidence);
            ReliefResult result;
            self.with([&](Relief& relief) {
              const py::gil_scoped_release nogil;
              relief.run(view, PixelRays(intrinsics), options, result, shares, interruptible());
            });
            return to_fields(std::move(result));
          },
          py::arg("depth"), py::arg("camera"), py::arg("options"),
          py::arg("confidence").noconvert() = py::none());
  m.def(
      "depth_coverage",
      [](const CArray<float>& points, const CArray<bool>& valid, const CArray<std::int32_t>& pixels,
         const CArray<std::int32_t>& faces, double max_edge, double max_step, double focal,
         const CArray<std::int32_t>& filled) {
        const BorrowedGrid grid(points, valid, true);
        const auto at = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
        const auto triangles = rows<Rows<std::int32_t, 3>>(faces, "faces");
        const auto closed = rows<Rows<std::int32_t, 2>>(filled, "filled");
        const py::gil_scoped_release nogil;
        return shares_in(
            depth_coverage(grid.view, at, triangles, {max_edge, max_step, focal}, closed));
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("pixels").noconvert(),
      py::arg("faces").noconvert(), py::arg("max_edge"), py::arg("max_step"), py::arg("focal"),
      py::arg("filled").noconvert());
  m.def(
      "faces_off_surface",
      [](const CArray<float>& points, const CArray<bool>& valid, const CArray<std::int32_t>& pixels,
         const CArray<std::int32_t>& faces, double max_edge, double max_step, double focal) {
        const BorrowedGrid grid(points, valid, true);
        const auto at = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
        const auto triangles = rows<Rows<std::int32_t, 3>>(faces, "faces");
        std::vector<float> shares;
        {
          const py::gil_scoped_release nogil;
          shares = faces_off_surface(grid.view, at, triangles, {max_edge, max_step, focal});
        }
        return to_numpy(std::move(shares));
      },
      py::arg("points").noconvert(), py::arg("valid").noconvert(), py::arg("pixels").noconvert(),
      py::arg("faces").noconvert(), py::arg("max_edge"), py::arg("max_step"), py::arg("focal"));
  m.def(
      "faces_across_steps",
      [](const CArray<float>& image, const CArray<std::int32_t>& pixels,
         const CArray<std::int32_t>& faces, double share, double slope, double noise,
         bool passing) {
        const DepthView view = depth_view(image);
        const auto at = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
        const auto triangles = rows<Rows<std::int32_t, 3>>(faces, "faces");
        std::vector<std::uint8_t> across;
        {
          const py::gil_scoped_release nogil;
          across = faces_across_steps(view, at, triangles, {share, slope, noise, passing});
        }
        return to_numpy(std::move(across));
      },
      py::arg("image").noconvert(), py::arg("pixels").noconvert(), py::arg("faces").noconvert(),
      py::arg("share"), py::arg("slope"), py::arg("noise"), py::arg("passing"));
  py::class_<Exclusive<DepthSmoother>>(m, "DepthSmoother")
      .def(py::init([](double newest_share, double gate) {
             return std::make_unique<Exclusive<DepthSmoother>>(
                 DepthSmootherOptions{newest_share, gate});
           }),
           py::arg("newest_share"), py::arg("gate"))
      .def("reset", exclusively(&DepthSmoother::reset))
      .def("starts_anew", exclusively(&DepthSmoother::starts_anew))
      .def(
          "add",
          [](Exclusive<DepthSmoother>& self, const py::array& depth) {
            const DepthView view = depth_view(depth);
            py::array_t<float> out({view.rows, view.cols});
            float* const pixels = out.mutable_data();
            self.with([&](DepthSmoother& smoother) {
              const py::gil_scoped_release nogil;
              std::ranges::copy(smoother.add(view), pixels);
            });
            return out;
          },
          py::arg("depth"))
      .def(
          "show",
          [](Exclusive<DepthSmoother>& self, const CArray<std::int32_t>& pixels,
             const CArray<float>& depths, const CArray<std::int32_t>& faces) {
            const auto at = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
            const auto triangles = rows<Rows<std::int32_t, 3>>(faces, "faces");
            const std::span<const float> z(depths.data(), depths.size());
            self.with([&](DepthSmoother& smoother) {
              const py::gil_scoped_release nogil;
              smoother.show(at, z, triangles);
            });
          },
          py::arg("pixels").noconvert(), py::arg("depths").noconvert(),
          py::arg("faces").noconvert());
}

}  // namespace manip3d::bindings
