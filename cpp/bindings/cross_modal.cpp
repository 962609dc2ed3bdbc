#include "manip3d/authenticate/cross_modal.hpp"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <array>
#include <cstdint>
#include <optional>
#include <tuple>
#include <utility>

#include "depth.hpp"
#include "fields.hpp"
#include "interruptible.hpp"
#include "modules.hpp"
#include "points.hpp"

namespace manip3d::bindings {
namespace {

constexpr std::tuple kCrossModalOptions{
    Field{"heading", &CrossModalOptions::heading},
    Field{"azimuth_step", &CrossModalOptions::azimuth_step},
    Field{"elevation_step", &CrossModalOptions::elevation_step},
    Field{"half_azimuth", &CrossModalOptions::half_azimuth},
    Field{"lowest", &CrossModalOptions::lowest},
    Field{"highest", &CrossModalOptions::highest},
    Field{"min_range", &CrossModalOptions::min_range},
    Field{"max_range", &CrossModalOptions::max_range},
    Field{"tolerance", &CrossModalOptions::tolerance},
    Field{"dark_level", &CrossModalOptions::dark_level},
    Field{"dark_weight", &CrossModalOptions::dark_weight},
    Field{"min_cells", &CrossModalOptions::min_cells},
    Field{"min_added_area", &CrossModalOptions::min_added_area},
    Field{"min_missing_area", &CrossModalOptions::min_missing_area},
};

constexpr std::tuple kCrossModalResult{
    Field{"rows", &CrossModalResult::rows},
    Field{"columns", &CrossModalResult::columns},
    Field{"lidar", &CrossModalResult::lidar},
    Field{"stereo", &CrossModalResult::stereo},
    Field{"difference", &CrossModalResult::difference},
    Field{"mask", &CrossModalResult::mask},
    Field{"judged", &CrossModalResult::judged},
    Field{"suspected", &CrossModalResult::suspected},
    Field{"suspected_component", &CrossModalResult::suspected_component},
    Field{"judged_points", &CrossModalResult::judged_points},
};

using XyzArray = std::array<double, 3>;
using CrossModalTuple =
    py::typing::Tuple<bool, std::int64_t, std::int64_t, std::int64_t, std::int64_t, double, double,
                      double, double, XyzArray, XyzArray, XyzArray>;

XyzArray to_array(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

}  // namespace

void bind_cross_modal(py::module_& m) {
  py::class_<CrossModalOptions> bound(m, "CrossModalOptions");
  bound.def(py::init<>());
  bind_fields(bound, kCrossModalOptions);
  m.def(
      "compare_cross_modal",
      [](const CArray<float>& points, const CArray<float>& disparity,
         const std::array<double, 4>& camera, const Eigen::Matrix4d& lidar_from_camera,
         const CrossModalOptions& options, const std::optional<CArray<std::uint8_t>>& grey) {
        const PointsView view = points_view(points, {});
        check_image(disparity, 0, "disparity");
        DisparityView image{disparity.data(), disparity.shape(0), disparity.shape(1)};
        if (grey.has_value()) {
          check_image(*grey, 0, "grey");
          if (grey->shape(0) != image.height || grey->shape(1) != image.width) {
            throw InputError("grey: expected as many pixels as disparity");
          }
          image.grey = grey->data();
        }
        const StereoView left{camera[0], camera[1], camera[2], camera[3], lidar_from_camera};
        CrossModalResult result;
        {
          const py::gil_scoped_release nogil;
          result = compare_cross_modal(view, image, left, options, interruptible());
        }
        py::typing::List<CrossModalTuple> components;
        for (const CrossModalComponent& c : result.components) {
          components.append(py::make_tuple(
              c.added, c.cells, c.empty, c.dark, c.behind, c.solid_angle, c.area, c.evidence,
              c.difference, to_array(c.lower), to_array(c.upper), to_array(c.center)));
        }
        return py::make_tuple(to_fields(std::move(result), kCrossModalResult), components);
      },
      py::arg("points").noconvert(), py::arg("disparity").noconvert(), py::arg("camera"),
      py::arg("lidar_from_camera"), py::arg("options"), py::arg("grey").noconvert() = py::none());
}

}  // namespace manip3d::bindings
