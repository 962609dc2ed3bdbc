#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <tuple>
#include <utility>
#include <vector>

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

// azimuth step, elevation step, azimuth phase, elevation phase, azimuth strength, elevation
// strength
using Grid = std::tuple<double, double, double, double, double, double>;

Grid to_python(const ScanGrid& grid) {
  return {grid.azimuth_step,    grid.elevation_step,   grid.azimuth_phase,
          grid.elevation_phase, grid.azimuth_strength, grid.elevation_strength};
}

ScanGrid to_grid(const Grid& grid) {
  return {std::get<0>(grid), std::get<1>(grid), std::get<2>(grid),
          std::get<3>(grid), std::get<4>(grid), std::get<5>(grid)};
}

/// Cells, solid angle, range, area, first and last row, first and last column, box.
using OcclusionTuple = py::typing::Tuple<std::int64_t, double, double, double, std::int64_t,
                                         std::int64_t, std::int64_t, std::int64_t, BoxTuple>;

OcclusionTuple to_python(const OcclusionComponent& c) {
  return py::make_tuple(c.cells, c.solid_angle, c.range, c.area, c.first_row, c.last_row,
                        c.first_column, c.last_column, box_to_python(c.box));
}

DensityOptions density_options(const Eigen::Vector3d& origin, std::int64_t sector,
                               double level_width, double level_growth, double max_range,
                               bool level_out, int threads) {
  return {origin, sector, level_width, level_growth, max_range, level_out, threads};
}

}  // namespace

void bind_authenticate(py::module_& m) {
  m.def(
      "estimate_scan_grid",
      [](const CArray<float>& points, const Eigen::Vector3d& origin, int threads) {
        const PointsView view = points_view(points, {});
        const py::gil_scoped_release nogil;
        return to_python(estimate_scan_grid(view, origin, threads, interruptible()));
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
        return std::make_tuple(r.found, std::tuple(r.position.x(), r.position.y(), r.position.z()),
                               r.axis, r.azimuth_step, r.elevation_step, r.azimuth_coherence,
                               r.elevation_coherence, r.explained);
      },
      py::arg("points").noconvert(), py::arg("known"), py::arg("tries_zero"), py::arg("threads"),
      py::arg("progress"));
  m.def(
      "occlusion_consistency",
      [](const CArray<float>& points, const Eigen::Vector3d& origin, const Grid& grid,
         double min_gap, bool accumulate, std::int64_t min_cells, double min_area, double max_range,
         int threads) {
        const PointsView view = points_view(points, {});
        OcclusionResult r;
        {
          const py::gil_scoped_release nogil;
          r = occlusion_consistency(
              view,
              {origin, to_grid(grid), min_gap, accumulate, min_cells, min_area, max_range, threads},
              interruptible());
        }
        py::typing::List<OcclusionTuple> components;
        for (const OcclusionComponent& c : r.components) components.append(to_python(c));
        return py::make_tuple(r.rows, r.columns, r.first_row, to_numpy(std::move(r.mask)),
                              to_numpy(std::move(r.raw_mask)), r.occupied_cells, r.multiple_cells,
                              components, to_numpy(std::move(r.suspected)),
                              to_numpy(std::move(r.suspected_component)));
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
