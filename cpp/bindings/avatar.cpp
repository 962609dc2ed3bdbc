#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "exclusive.hpp"
#include "interruptible.hpp"
#include "manip3d/geometry/mesh.hpp"
#include "manip3d/modify/colliders.hpp"
#include "manip3d/modify/placement.hpp"
#include "manip3d/modify/repose.hpp"
#include "manip3d/modify/shoe_cover.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "python_types.hpp"
#include "rgbd.hpp"

namespace manip3d::bindings {
namespace {

py::array_t<float> to_array(const Eigen::Vector3f& vector) {
  return py::array_t<float>(3, vector.data());
}

using FloatArray = py::array_t<float>;

/// Tables of all bones (start, end, radius; 0: no bone), and the torso's box.
py::typing::Tuple<FloatArray, FloatArray, FloatArray, FloatArray> to_tables(
    const BodyColliders& body) {
  CArray<float> capsules({kNumJoints, std::size_t{7}});
  for (std::size_t bone = 0; bone < kNumJoints; ++bone) {
    const Capsule& capsule = body.capsules[bone];
    float* row = capsules.mutable_data(static_cast<py::ssize_t>(bone));
    std::copy_n(capsule.start.data(), 3, row);
    std::copy_n(capsule.end.data(), 3, row + 3);
    row[6] = capsule.radius;
  }
  const Eigen::Matrix<float, 3, 3, Eigen::RowMajor> axes = body.torso.rotation.toRotationMatrix();
  CArray<float> rotation({3, 3}, axes.data());
  return py::make_tuple(capsules, to_array(body.torso.centre), rotation,
                        to_array(body.torso.half_size));
}

/// Time, bone and point of each target.
using HitTables = py::typing::Tuple<py::array_t<double>, py::array_t<std::int8_t>, FloatArray>;

HitTables first_hits(Exclusive<ColliderTracker>& self, const CArray<float>& from,
                     const CArray<float>& to, const CArray<float>& radius) {
  const auto starts = rows<Rows<float, 3>>(from, "start");
  const auto ends = rows<Rows<float, 3>>(to, "end");
  if (starts.rows() != ends.rows() || radius.ndim() != 1 || radius.shape(0) != starts.rows()) {
    throw InputError("targets: expected as many ends and radii as starts (" +
                     std::to_string(starts.rows()) + ")");
  }
  const auto count = starts.rows();
  Eigen::VectorXd time = Eigen::VectorXd::Constant(count, std::nan(""));
  Eigen::Matrix<std::int8_t, Eigen::Dynamic, 1> bone =
      Eigen::Matrix<std::int8_t, Eigen::Dynamic, 1>::Constant(count, -1);
  Rows<float, 3> point = Rows<float, 3>::Constant(count, 3, std::nanf(""));
  const auto [before, now] = self.with(
      [](const ColliderTracker& tracker) { return std::pair(tracker.before(), tracker.now()); });
  {
    const py::gil_scoped_release nogil;
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto hit = first_hit(before, now, {starts.row(i), ends.row(i), radius.data()[i]});
      if (!hit) continue;
      time[i] = hit->time;
      bone[i] = static_cast<std::int8_t>(hit->bone);
      point.row(i) = hit->point;
    }
  }
  return py::make_tuple(to_numpy(std::move(time)), to_numpy(std::move(bone)),
                        to_numpy(std::move(point)));
}

/// A ShoeCoverTracker with the rays of its latest calibration. It processes one frame at a time.
class Shoe {
 public:
  explicit Shoe(const ShoeCoverOptions& options) : tracker_(options) {}

  OptionalFields update(const PyRgbdFrame& frame, const PySkeleton& skeleton, bool left) {
    const py::object calibration = frame.attr("calibration");
    if (!calibration.is(seen_)) {
      frame_.calibration = std::make_shared<RgbdCalibration>(to_calibration(calibration));
      rays_ = PixelRays(frame_.calibration->depth);
      seen_ = calibration;
    }
    to_frame(frame, frame_);
    Skeleton moved = to_skeleton(skeleton);
    bool found = false;
    {
      const py::gil_scoped_release nogil;
      found = tracker_.update(frame_, rays_, left, moved);
    }
    return found ? py::object(from_skeleton(moved)) : py::object(py::none());
  }

  [[nodiscard]] std::int64_t num_pixels() const { return tracker_.num_pixels(); }

 private:
  ShoeCoverTracker tracker_;
  RgbdFrame frame_;
  PixelRays rays_;
  py::object seen_ = py::none();
};

OptionalFields to_dict(const std::optional<Placement>& placement) {
  if (!placement) return py::none();
  py::dict fields;
  fields["knee_height"] = placement->knee_height;
  fields["reach"] = placement->reach;
  fields["left"] = to_array(placement->left);
  fields["right"] = to_array(placement->right);
  fields["stable_frames"] = placement->stable_frames;
  fields["frozen"] = placement->frozen;
  return fields;
}

/// Moved vertices and the fields of the moved skeleton; None if the torso is missing.
template <typename Scalar>
VerticesAndSkeleton repose(const CArray<Scalar>& vertices, const PySkeleton& skeleton,
                           const OptionalPySkeleton& rest, const ReposeOptions& options) {
  const auto from = rows<Rows<Scalar, 3>>(vertices, "vertices");
  const Skeleton now = to_skeleton(skeleton);
  const Skeleton at_rest = rest.is_none() ? Skeleton() : to_skeleton(rest);
  const bool given = !rest.is_none();
  Rows<Scalar, 3> to(from.rows(), 3);
  std::optional<BoneMotions> motions;
  {
    const py::gil_scoped_release nogil;
    motions = amplify(now, given ? &at_rest : nullptr, options);
    if (motions) {
      repose_vertices(from.data(), from.rows(), now, *motions, options, to.data(), interruptible());
    }
  }
  if (!motions) return py::none();
  return py::make_tuple(to_numpy(std::move(to)), from_skeleton(move_skeleton(now, *motions)));
}

}  // namespace

void bind_avatar(py::module_& m) {
  py::class_<Exclusive<ColliderTracker>>(m, "ColliderTracker")
      .def(py::init([](double percentile, int frames, int min_points, double min_radius,
                       double max_radius, double first_radius) {
             return std::make_unique<Exclusive<ColliderTracker>>(ColliderOptions{
                 percentile, frames, min_points, min_radius, max_radius, first_radius});
           }),
           py::kw_only(), py::arg("percentile"), py::arg("frames"), py::arg("min_points"),
           py::arg("min_radius"), py::arg("max_radius"), py::arg("first_radius"))
      .def(
          "update",
          [](Exclusive<ColliderTracker>& self, const PySkeleton& skeleton,
             const CArray<std::uint8_t>& label, const CArray<float>& squared_distance) {
            const Skeleton pose = to_skeleton(skeleton);
            const std::span labels(label.data(), static_cast<std::size_t>(label.size()));
            const std::span distances(squared_distance.data(),
                                      static_cast<std::size_t>(squared_distance.size()));
            return to_tables(self.with([&](ColliderTracker& tracker) {
              const py::gil_scoped_release nogil;
              tracker.update(pose, labels, distances);
              return tracker.now();
            }));
          },
          py::arg("skeleton"), py::arg("label").noconvert(),
          py::arg("squared_distance").noconvert())
      .def("reset", exclusively(&ColliderTracker::reset))
      .def("now",
           [](Exclusive<ColliderTracker>& self) {
             return to_tables(
                 self.with([](const ColliderTracker& tracker) { return tracker.now(); }));
           })
      .def("first_hits", &first_hits, py::arg("start").noconvert(), py::arg("end").noconvert(),
           py::arg("radius").noconvert());

  py::class_<Exclusive<Shoe>>(m, "ShoeCoverTracker")
      .def(py::init([](std::pair<int, int> hue, int min_saturation, int min_value, double reach,
                       int min_pixels) {
             return std::make_unique<Exclusive<Shoe>>(ShoeCoverOptions{
                 hue.first, hue.second, min_saturation, min_value, reach, min_pixels});
           }),
           py::kw_only(), py::arg("hue"), py::arg("min_saturation"), py::arg("min_value"),
           py::arg("reach"), py::arg("min_pixels"))
      .def("update", exclusively(&Shoe::update), py::arg("frame"), py::arg("skeleton"),
           py::arg("left"))
      .def_property_readonly("num_pixels", exclusively(&Shoe::num_pixels));

  py::class_<Exclusive<PlacementEstimator>>(m, "PlacementEstimator")
      .def(py::init([](double share, double spread, int stable_frames, double tolerance) {
             return std::make_unique<Exclusive<PlacementEstimator>>(
                 PlacementOptions{share, spread, stable_frames, tolerance});
           }),
           py::kw_only(), py::arg("share"), py::arg("spread"), py::arg("stable_frames"),
           py::arg("tolerance"))
      .def(
          "update",
          [](Exclusive<PlacementEstimator>& self, const PySkeleton& skeleton, bool left_is_intact) {
            const Skeleton pose = to_skeleton(skeleton);
            return to_dict(self.with([&](PlacementEstimator& estimator) {
              return estimator.update(pose, left_is_intact);
            }));
          },
          py::arg("skeleton"), py::arg("left_is_intact"))
      .def("reset", exclusively(&PlacementEstimator::reset));

  py::class_<ReposeOptions>(m, "ReposeOptions")
      .def(py::init<>())
      .def_readwrite("gain", &ReposeOptions::gain)
      .def_readwrite("limit", &ReposeOptions::limit)
      .def_readwrite("blended", &ReposeOptions::blended)
      .def_readwrite("band", &ReposeOptions::band)
      .def_readwrite("num_threads", &ReposeOptions::num_threads);
  m.def("repose", &repose<float>, py::arg("vertices").noconvert(), py::arg("skeleton"),
        py::arg("rest"), py::arg("options"));
  m.def("repose", &repose<double>, py::arg("vertices").noconvert(), py::arg("skeleton"),
        py::arg("rest"), py::arg("options"));
  m.def("is_posable", &is_posable, py::arg("joint"));
}

}  // namespace manip3d::bindings
