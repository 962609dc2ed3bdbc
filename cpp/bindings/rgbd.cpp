#include "rgbd.hpp"

#include <pybind11/stl.h>

#include <algorithm>
#include <string>
#include <vector>

#include "depth.hpp"
#include "modules.hpp"
#include "numpy.hpp"

namespace manip3d::bindings {

namespace {

template <typename T>
void copy_image(const py::object& image, std::vector<T>& to) {
  to.clear();
  if (image.is_none()) return;
  const auto array = image.cast<CArray<T>>();
  to.assign(array.data(), array.data() + array.size());
}

}  // namespace

Skeleton to_skeleton(const py::handle& skeleton) {
  Skeleton result;
  const auto positions = skeleton.attr("positions").cast<CArray<float>>();
  const auto orientations = skeleton.attr("orientations").cast<CArray<float>>();
  const auto states = skeleton.attr("states").cast<CArray<std::uint8_t>>();
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const auto row = static_cast<py::ssize_t>(joint);
    result.positions[joint] = Eigen::Map<const Eigen::Vector3f>(positions.data(row));
    std::copy_n(orientations.data(row), 4, result.orientations[joint].begin());
    result.states[joint] = static_cast<TrackingState>(states.at(row));
  }
  result.id = skeleton.attr("id").cast<std::int64_t>();
  result.body = skeleton.attr("body").cast<std::uint8_t>();
  return result;
}

py::dict from_skeleton(const Skeleton& skeleton) {
  CArray<float> positions({kNumJoints, std::size_t{3}});
  CArray<float> orientations({kNumJoints, std::size_t{4}});
  CArray<std::uint8_t> states(kNumJoints);
  for (std::size_t joint = 0; joint < kNumJoints; ++joint) {
    const auto row = static_cast<py::ssize_t>(joint);
    std::copy_n(skeleton.positions[joint].data(), 3, positions.mutable_data(row));
    std::copy_n(skeleton.orientations[joint].data(), 4, orientations.mutable_data(row));
    states.mutable_at(row) = static_cast<std::uint8_t>(skeleton.states[joint]);
  }
  py::dict fields;
  fields["positions"] = positions;
  fields["orientations"] = orientations;
  fields["states"] = states;
  fields["id"] = skeleton.id;
  fields["body"] = skeleton.body;
  return fields;
}

RgbdCalibration to_calibration(const py::handle& calibration) {
  RgbdCalibration result;
  py::object rays;
  result.depth = to_intrinsics(calibration.attr("depth"), rays);
  if (!rays.is_none()) {
    const auto table = rays.cast<CArray<float>>();
    result.ray_table.assign(table.data(), table.data() + table.size());
    result.depth.ray_table = result.ray_table.data();
  }
  const py::object registration = calibration.attr("registration");
  if (!registration.is_none()) result.registration = to_registration(registration);
  return result;
}

void to_frame(const py::handle& from, RgbdFrame& frame) {
  frame.number = from.attr("number").cast<std::int64_t>();
  frame.time_ns = from.attr("time_ns").cast<std::int64_t>();
  const auto depth = from.attr("depth").cast<CArray<std::uint16_t>>();
  frame.rows = depth.shape(0);
  frame.cols = depth.shape(1);
  copy_image<std::uint16_t>(depth, frame.depth);
  copy_image<std::uint8_t>(from.attr("body_index"), frame.body_index);
  const py::object color = from.attr("color");
  copy_image<std::uint8_t>(color, frame.color);
  frame.color_rows = color.is_none() ? 0 : color.attr("shape")[py::int_(0)].cast<std::int64_t>();
  frame.color_cols = color.is_none() ? 0 : color.attr("shape")[py::int_(1)].cast<std::int64_t>();
  frame.skeletons.clear();
  for (const py::handle skeleton : from.attr("skeletons")) {
    frame.skeletons.push_back(to_skeleton(skeleton));
  }
}

void bind_rgbd(py::module_& m) {
  m.def("joint_names",
        [] { return std::vector<std::string>(kJointNames.begin(), kJointNames.end()); });
  m.def("joint_parents",
        [] { return std::vector<int>(kJointParents.begin(), kJointParents.end()); });
  m.def("mirrored_joints",
        [] { return std::vector<int>(kMirroredJoints.begin(), kMirroredJoints.end()); });
}

}  // namespace manip3d::bindings
