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

constexpr std::tuple kCrossModalComponent{
    Field{"added", &CrossModalComponent::added},
    Field{"cells", &CrossModalComponent::cells},
    Field{"empty", &CrossModalComponent::empty},
    Field{"dark", &CrossModalComponent::dark},
    Field{"behind", &CrossModalComponent::behind},
    Field{"solid_angle", &CrossModalComponent::solid_angle},
    Field{"area", &CrossModalComponent::area},
    Field{"evidence", &CrossModalComponent::evidence},
    Field{"difference", &CrossModalComponent::difference},
};

py::tuple to_tuple(const Eigen::Vector3d& v) { return py::make_tuple(v.x(), v.y(), v.z()); }

Fields to_fields(CrossModalResult&& result) {
  py::list components;
  for (const CrossModalComponent& each : result.components) {
    Fields component = to_fields(CrossModalComponent(each), kCrossModalComponent);
    component["lower"] = to_tuple(each.lower);
    component["upper"] = to_tuple(each.upper);
    component["center"] = to_tuple(each.center);
    components.append(component);
  }
  Fields fields = to_fields(std::move(result), kCrossModalResult);
  fields["components"] = components;
  return fields;
}

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
        return to_fields(std::move(result));
      },
      py::arg("points").noconvert(), py::arg("disparity").noconvert(), py::arg("camera"),
      py::arg("lidar_from_camera"), py::arg("options"), py::arg("grey").noconvert() = py::none());
}

}  // namespace manip3d::bindings
