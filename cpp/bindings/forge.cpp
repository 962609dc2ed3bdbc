#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <string>
#include <utility>
#include <vector>

#include "interruptible.hpp"
#include "manip3d/forge/attacks.hpp"
#include "manip3d/forge/insertion.hpp"
#include "manip3d/forge/lattice.hpp"
#include "manip3d/forge/segment.hpp"
#include "manip3d/geometry/angles.hpp"
#include "modules.hpp"
#include "points.hpp"

namespace manip3d::bindings {
namespace {

using Box = std::tuple<Eigen::Vector3d, Eigen::Vector3d, double>;
using Rings = std::vector<std::pair<double, double>>;

OrientedBox to_box(const Box& box) {
  return {std::get<0>(box), std::get<1>(box), std::get<2>(box)};
}

/// Points, intensity, rows (added, moved, moved from, removed), box, transform.
using ForgedTuple = py::typing::Tuple<py::array_t<float>, std::optional<py::array_t<float>>,
                                      py::array_t<std::int32_t>, py::array_t<std::int32_t>,
                                      py::array_t<std::int32_t>, py::array_t<std::int32_t>,
                                      BoxTuple, py::array_t<double>>;

ForgedTuple to_python(Forgery&& forged) {
  const bool has_intensity = forged.intensity.size() > 0;
  const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> transform = forged.transform;
  return py::make_tuple(
      to_numpy_rows<3>(std::move(forged.points)),
      has_intensity ? py::object(to_numpy_rows<1>(std::move(forged.intensity))) : py::none(),
      to_numpy(std::move(forged.added)), to_numpy(std::move(forged.moved)),
      to_numpy(std::move(forged.moved_from)), to_numpy(std::move(forged.removed)),
      box_to_python(forged.box), py::array_t<double>({4, 4}, transform.data()));
}

ObjectPlacement placement(const Eigen::Vector3d& position, const Eigen::Matrix3d& rotation,
                          double scale, bool paper) {
  return {position, rotation, scale, paper ? Translation::kPaper : Translation::kCentroid};
}

ScanLattice to_lattice(const Rings& rings, double azimuth_step, double azimuth_phase) {
  ScanLattice lattice;
  for (const auto& [slope, offset] : rings) {
    lattice.rings.push_back({.slope = slope, .offset = offset, .azimuth = azimuth_phase});
  }
  lattice.azimuth_step = azimuth_step;
  return lattice;
}

// Runs an attack without the GIL; Ctrl-C interrupts it.
template <typename Attack>
ForgedTuple forged_by(const Attack& attack) {
  Forgery forged;
  {
    const py::gil_scoped_release nogil;
    forged = attack(interruptible());
  }
  return to_python(std::move(forged));
}

void bind_selection(py::module_& m) {
  m.def("rotation_about_z", &rotation_about_z, py::arg("yaw"));
  m.def(
      "points_in_box",
      [](const CArray<float>& points, const Box& box, int threads) {
        const PointsView view = points_view(points, {});
        std::vector<std::int32_t> rows;
        {
          const py::gil_scoped_release nogil;
          rows = points_in_box(view, to_box(box), threads, interruptible());
        }
        return to_numpy(std::move(rows));
      },
      py::arg("points").noconvert(), py::arg("box"), py::arg("threads"));
}

void bind_pasting(py::module_& m) {
  m.def(
      "copy_transform_paste",
      [](const CArray<float>& points, const CArray<float>& intensity, const CArray<float>& object,
         const CArray<float>& object_intensity, const Eigen::Vector3d& position,
         const Eigen::Matrix3d& rotation, double scale, bool paper, int threads) {
        const PointsView scene = points_view(points, intensity);
        const PointsView hoax = points_view(object, object_intensity);
        return forged_by([&](const Progress& progress) {
          return copy_transform_paste(scene, hoax, placement(position, rotation, scale, paper),
                                      threads, progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(),
      py::arg("object").noconvert(), py::arg("object_intensity").noconvert(), py::arg("position"),
      py::arg("rotation"), py::arg("scale"), py::arg("paper"), py::arg("threads"));
  m.def(
      "resample",
      [](const CArray<float>& object, const CArray<std::int32_t>& faces, double spacing,
         bool uniform, std::uint64_t seed, int threads) {
        const PointsView view = points_view(object, {});
        const auto triangles = rows<Faces>(faces, "faces");
        Points points;
        {
          const py::gil_scoped_release nogil;
          points = resample(
              view, triangles,
              {spacing, uniform ? Resampling::kUniform : Resampling::kPoissonDisk, seed, threads},
              interruptible());
        }
        return to_numpy(std::move(points));
      },
      py::arg("object").noconvert(), py::arg("faces").noconvert(), py::arg("spacing"),
      py::arg("uniform"), py::arg("seed"), py::arg("threads"));
  m.def(
      "local_spacing",
      [](const CArray<float>& points, const Eigen::Vector3d& position, double radius, int threads) {
        const PointsView scene = points_view(points, {});
        const py::gil_scoped_release nogil;
        return local_spacing(scene, position, radius, threads, interruptible());
      },
      py::arg("points").noconvert(), py::arg("position"), py::arg("radius"), py::arg("threads"));
}

void bind_changes(py::module_& m) {
  m.def(
      "subtract",
      [](const CArray<float>& points, const CArray<float>& intensity, const Box& box, int threads) {
        const PointsView scene = points_view(points, intensity);
        return forged_by([&](const Progress& progress) {
          return subtract(scene, to_box(box), threads, progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(), py::arg("box"),
      py::arg("threads"));
  m.def(
      "replace_rows",
      [](const CArray<float>& points, const CArray<float>& intensity,
         const CArray<std::int32_t>& removed, const CArray<float>& added,
         const CArray<float>& added_intensity, int threads) {
        const PointsView scene = points_view(points, intensity);
        const PointsView more = points_view(added, added_intensity);
        const std::vector<std::int32_t> gone = row_vector(removed);
        return forged_by([&](const Progress& progress) {
          return replace_rows(scene, gone, more, threads, progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(),
      py::arg("removed").noconvert(), py::arg("added").noconvert(),
      py::arg("added_intensity").noconvert(), py::arg("threads"));
  m.def(
      "deform",
      [](const CArray<float>& points, const CArray<float>& intensity, const Box& box,
         double amplitude, bool along_normal, const Eigen::Vector3d& origin, std::uint64_t seed,
         int threads) {
        const PointsView scene = points_view(points, intensity);
        const DeformOptions options{
            amplitude, along_normal ? Displacement::kNormal : Displacement::kRandom, origin, seed};
        return forged_by([&](const Progress& progress) {
          return deform(scene, to_box(box), options, threads, progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(), py::arg("box"),
      py::arg("amplitude"), py::arg("along_normal"), py::arg("origin"), py::arg("seed"),
      py::arg("threads"));
  m.def(
      "move_box",
      [](const CArray<float>& points, const CArray<float>& intensity, const Box& box,
         const Eigen::Matrix4d& transform, int threads) {
        const PointsView scene = points_view(points, intensity);
        return forged_by([&](const Progress& progress) {
          return move_box(scene, to_box(box), transform, threads, progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(), py::arg("box"),
      py::arg("transform"), py::arg("threads"));
}

void bind_insertion(py::module_& m) {
  m.def(
      "insert_occluding",
      [](const CArray<float>& points, const CArray<float>& intensity, const CArray<float>& object,
         const CArray<std::int32_t>& faces, const Eigen::Vector3d& position,
         const Eigen::Matrix3d& rotation, double scale, const Eigen::Vector3d& origin,
         double range_noise, const Rings& rings, double azimuth_step, double azimuth_phase,
         std::uint64_t seed, int threads) {
        const PointsView scene = points_view(points, intensity);
        const PointsView hoax = points_view(object, {});
        const auto triangles = rows<Faces>(faces, "faces");
        const InsertionOptions options{origin, range_noise, seed,
                                       to_lattice(rings, azimuth_step, azimuth_phase)};
        return forged_by([&](const Progress& progress) {
          return insert_occluding(scene, hoax, triangles,
                                  placement(position, rotation, scale, false), options, threads,
                                  progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(),
      py::arg("object").noconvert(), py::arg("faces").noconvert(), py::arg("position"),
      py::arg("rotation"), py::arg("scale"), py::arg("origin"), py::arg("range_noise"),
      py::arg("rings"), py::arg("azimuth_step"), py::arg("azimuth_phase"), py::arg("seed"),
      py::arg("threads"));
  m.def(
      "snap_to_lattice",
      [](const CArray<float>& points, const CArray<float>& intensity,
         const CArray<std::int32_t>& snapped, const Rings& rings, double azimuth_step,
         double azimuth_phase, bool along_ray, bool azimuth, double max_move, int threads) {
        const PointsView scene = points_view(points, intensity);
        const ScanLattice lattice = to_lattice(rings, azimuth_step, azimuth_phase);
        const SnapOptions options{along_ray ? Snapping::kRay : Snapping::kHeight, azimuth,
                                  max_move};
        const std::vector<std::int32_t> touched = row_vector(snapped);
        return forged_by([&](const Progress& progress) {
          return snap_to_lattice(scene, touched, lattice, options, threads, progress);
        });
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert(),
      py::arg("snapped").noconvert(), py::arg("rings"), py::arg("azimuth_step"),
      py::arg("azimuth_phase"), py::arg("along_ray"), py::arg("azimuth"), py::arg("max_move"),
      py::arg("threads"));
}

void bind_segmentation(py::module_& m) {
  m.def(
      "segment_objects",
      [](const CArray<float>& points, const Eigen::Vector3d& origin, double max_range,
         double ground_height, double ground_slope, double tolerance, std::int64_t min_points,
         double max_size) {
        const PointsView scene = points_view(points, {});
        Segmentation result;
        {
          const py::gil_scoped_release nogil;
          result = segment_objects(
              scene,
              {origin, max_range, ground_height, ground_slope, tolerance, min_points, max_size},
              interruptible());
        }
        py::typing::List<BoxTuple> boxes;
        for (const OrientedBox& box : result.boxes) boxes.append(box_to_python(box));
        return py::make_tuple(to_numpy(std::move(result.labels)), boxes);
      },
      py::arg("points").noconvert(), py::arg("origin"), py::arg("max_range"),
      py::arg("ground_height"), py::arg("ground_slope"), py::arg("tolerance"),
      py::arg("min_points"), py::arg("max_size"));
}

}  // namespace

void bind_forge(py::module_& m) {
  bind_selection(m);
  bind_pasting(m);
  bind_changes(m);
  bind_insertion(m);
  bind_segmentation(m);
}

}  // namespace manip3d::bindings
