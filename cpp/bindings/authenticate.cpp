#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "fields.hpp"
#include "interruptible.hpp"
#include "manip3d/authenticate/density.hpp"
#include "manip3d/authenticate/occlusion.hpp"
#include "manip3d/geometry/scan_grid.hpp"
#include "manip3d/geometry/scan_origin.hpp"
#include "modules.hpp"
#include "points.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

constexpr std::tuple kScanGrid{
    Field{"azimuth_step", &ScanGrid::azimuth_step},
    Field{"elevation_step", &ScanGrid::elevation_step},
    Field{"azimuth_phase", &ScanGrid::azimuth_phase},
    Field{"elevation_phase", &ScanGrid::elevation_phase},
    Field{"azimuth_strength", &ScanGrid::azimuth_strength},
    Field{"elevation_strength", &ScanGrid::elevation_strength},
};

constexpr std::tuple kScanOrigin{
    Field{"found", &ScanOrigin::found},
    Field{"axis", &ScanOrigin::axis},
    Field{"azimuth_step", &ScanOrigin::azimuth_step},
    Field{"elevation_step", &ScanOrigin::elevation_step},
    Field{"azimuth_coherence", &ScanOrigin::azimuth_coherence},
    Field{"elevation_coherence", &ScanOrigin::elevation_coherence},
    Field{"explained", &ScanOrigin::explained},
};

constexpr std::tuple kOcclusionComponent{
    Field{"cells", &OcclusionComponent::cells},
    Field{"solid_angle", &OcclusionComponent::solid_angle},
    Field{"range", &OcclusionComponent::range},
    Field{"area", &OcclusionComponent::area},
    Field{"first_row", &OcclusionComponent::first_row},
    Field{"last_row", &OcclusionComponent::last_row},
    Field{"first_column", &OcclusionComponent::first_column},
    Field{"last_column", &OcclusionComponent::last_column},
};

constexpr std::tuple kOcclusionResult{
    Field{"rows", &OcclusionResult::rows},
    Field{"columns", &OcclusionResult::columns},
    Field{"first_row", &OcclusionResult::first_row},
    Field{"mask", &OcclusionResult::mask},
    Field{"raw_mask", &OcclusionResult::raw_mask},
    Field{"occupied_cells", &OcclusionResult::occupied_cells},
    Field{"multiple_cells", &OcclusionResult::multiple_cells},
    Field{"suspected", &OcclusionResult::suspected},
    Field{"suspected_component", &OcclusionResult::suspected_component},
};

Fields to_fields(const ScanOrigin& origin) {
  Fields fields = to_fields(ScanOrigin(origin), kScanOrigin);
  fields["position"] =
      py::make_tuple(origin.position.x(), origin.position.y(), origin.position.z());
  return fields;
}

Fields to_fields(OcclusionResult&& result) {
  py::list components;
  for (const OcclusionComponent& each : result.components) {
    Fields component = to_fields(OcclusionComponent(each), kOcclusionComponent);
    component["box"] = box_to_python(each.box);
    components.append(component);
  }
  Fields fields = to_fields(std::move(result), kOcclusionResult);
  fields["components"] = components;
  return fields;
}

DensityOptions density_options(const Eigen::Vector3d& origin, std::int64_t sector,
                               double level_width, double level_growth, double max_range,
                               bool level_out, int threads) {
  return {origin, sector, level_width, level_growth, max_range, level_out, threads};
}

}  // namespace

void bind_authenticate(py::module_& m) {
  py::class_<ScanGrid> scan_grid(m, "ScanGrid");
  scan_grid.def(py::init<>());
  bind_fields(scan_grid, kScanGrid);
  m.def(
      "estimate_scan_grid",
      [](const CArray<float>& points, const Eigen::Vector3d& origin, int threads) {
        const PointsView view = points_view(points, {});
        const py::gil_scoped_release nogil;
        return estimate_scan_grid(view, origin, threads, interruptible());
      },
      py::arg("points").noconvert(), py::arg("origin"), py::arg("threads"));
  m.def(
      "estimate_scan_origin",
      [](const CArray<float>& points, const std::optional<Eigen::Vector3d>& known, bool tries_zero,
         int threads, const PyProgress& progress) {
        const PointsView view = points_view(points, {});
        const Progress report = interruptible(progress);
        ScanOrigin r;
        {
          const py::gil_scoped_release nogil;
          r = estimate_scan_origin(view, {known, tries_zero, threads}, report);
        }
        return to_fields(r);
      },
      py::arg("points").noconvert(), py::arg("known"), py::arg("tries_zero"), py::arg("threads"),
      py::arg("progress"));
  m.def(
      "occlusion_consistency",
      [](const CArray<float>& points, const Eigen::Vector3d& origin, const ScanGrid& grid,
         double min_gap, bool accumulate, std::int64_t min_cells, double min_area, double max_range,
         int threads) {
        const PointsView view = points_view(points, {});
        OcclusionResult r;
        {
          const py::gil_scoped_release nogil;
          r = occlusion_consistency(
              view, {origin, grid, min_gap, accumulate, min_cells, min_area, max_range, threads},
              interruptible());
        }
        return to_fields(std::move(r));
      },
      py::arg("points").noconvert(), py::arg("origin"), py::arg("grid"), py::arg("min_gap"),
      py::arg("accumulate"), py::arg("min_cells"), py::arg("min_area"), py::arg("max_range"),
      py::arg("threads"));
  m.def(
      "density_levels",
      [](const CArray<float>& points, const CArray<double>& distances,
         const Eigen::Vector3d& origin, std::int64_t sector, double level_width,
         double level_growth, double max_range, bool level_out, int threads) {
        const PointsView view = points_view(points, {});
        const auto values = rows<Eigen::VectorXd>(distances, "distances");
        const DensityOptions options = density_options(origin, sector, level_width, level_growth,
                                                       max_range, level_out, threads);
        DensityLevels levels;
        {
          const py::gil_scoped_release nogil;
          levels = density_levels(view, {values.data(), static_cast<std::size_t>(values.size())},
                                  options, interruptible());
        }
        return py::make_tuple(levels.sectors, to_numpy(std::move(levels.edges)),
                              to_numpy(std::move(levels.counts)),
                              to_numpy(std::move(levels.means)));
      },
      py::arg("points").noconvert(), py::arg("distances").noconvert(), py::arg("origin"),
      py::arg("sector"), py::arg("level_width"), py::arg("level_growth"), py::arg("max_range"),
      py::arg("level_out"), py::arg("threads"));
  m.def(
      "points_of_levels",
      [](const CArray<float>& points, const CArray<std::uint8_t>& marked,
         const Eigen::Vector3d& origin, std::int64_t sector, double level_width,
         double level_growth, double max_range, int threads) {
        const PointsView view = points_view(points, {});
        const DensityOptions options =
            density_options(origin, sector, level_width, level_growth, max_range, false, threads);
        std::vector<std::int32_t> found;
        {
          const std::size_t size = marked.size();
          const std::uint8_t* marks = marked.data();
          const py::gil_scoped_release nogil;
          found = points_of_levels(view, {marks, size}, options, interruptible());
        }
        return to_numpy(std::move(found));
      },
      py::arg("points").noconvert(), py::arg("marked").noconvert(), py::arg("origin"),
      py::arg("sector"), py::arg("level_width"), py::arg("level_growth"), py::arg("max_range"),
      py::arg("threads"));
}

}  // namespace manip3d::bindings
