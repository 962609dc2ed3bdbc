#include <pybind11/native_enum.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "depth.hpp"
#include "manip3d/authenticate/depth_noise.hpp"
#include "manip3d/forge/composite.hpp"
#include "manip3d/modify/animation.hpp"
#include "manip3d/modify/region_growing.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "manip3d/modify/speckles.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "python_types.hpp"
#include "rgbd.hpp"

namespace manip3d::bindings {
namespace {

using Bytes = CArray<std::uint8_t>;

py::typing::Tuple<Bytes, py::array_t<float>> segment_region(
    const py::array& depth, const std::optional<Bytes>& body_index, const PyIntrinsics& camera,
    const PySkeleton& skeleton, const PersonMaskOptions& mask, const RegionOptions& options) {
  const DepthView view = depth_view(depth);
  if (body_index) check_image(*body_index, 0, "body_index");
  py::object keep;
  const Intrinsics intrinsics = to_intrinsics(camera, keep);
  const Skeleton person = to_skeleton(skeleton);
  LabelImage image;
  {
    const py::gil_scoped_release nogil;
    const PixelRays rays(intrinsics);
    const std::uint8_t* index = body_index ? body_index->data() : nullptr;
    PersonPoints points;
    find_person(view, index, person, rays, mask, points);
    grow_bones(person, intrinsics, index != nullptr && person.body != kNoBody, options, points);
    image = label_image(points);
  }
  return py::make_tuple(to_numpy(std::move(image.labels)), to_numpy(std::move(image.distances)));
}

/// Copies of depth and labels in which single missing pixels are filled.
py::typing::Tuple<CArray<std::uint16_t>, Bytes> without_speckles(const CArray<std::uint16_t>& depth,
                                                                 const Bytes& labels) {
  check_image(depth, 0, "depth");
  check_image(labels, 0, "labels");
  if (labels.shape(0) != depth.shape(0) || labels.shape(1) != depth.shape(1)) {
    throw InputError("labels: expected the shape of depth");
  }
  CArray<std::uint16_t> filled({depth.shape(0), depth.shape(1)});
  Bytes bones({depth.shape(0), depth.shape(1)});
  std::uint16_t* z = filled.mutable_data();
  std::uint8_t* bone = bones.mutable_data();
  const std::uint16_t* from = depth.data();
  const std::uint8_t* label = labels.data();
  {
    const py::gil_scoped_release nogil;
    std::copy_n(from, filled.size(), z);
    std::copy_n(label, bones.size(), bone);
    fill_speckles(filled.shape(0), filled.shape(1), z, bone);
  }
  return py::make_tuple(filled, bones);
}

/// Vertices, pixels, labels, faces.
using MeshTables = py::typing::Tuple<py::array_t<float>, py::array_t<std::int32_t>,
                                     py::array_t<std::uint8_t>, py::array_t<std::int32_t>>;

MeshTables make_animation_mesh(const py::array& depth, const Bytes& labels,
                               const PyIntrinsics& camera, const OptionalPySkeleton& skeleton,
                               const AnimationMeshOptions& options) {
  const DepthView view = depth_view(depth);
  check_image(labels, 0, "labels");
  if (labels.shape(0) != view.rows || labels.shape(1) != view.cols) {
    throw InputError("labels: expected the shape of depth");
  }
  py::object keep;
  const Intrinsics intrinsics = to_intrinsics(camera, keep);
  std::optional<Skeleton> person;
  if (!skeleton.is_none()) person = to_skeleton(skeleton);
  AnimationMesh mesh;
  {
    const py::gil_scoped_release nogil;
    mesh = animation_mesh(view, PixelRays(intrinsics), intrinsics.fx, labels.data(),
                          person ? &*person : nullptr, options);
  }
  return py::make_tuple(to_numpy(std::move(mesh.vertices)), to_numpy(std::move(mesh.pixels)),
                        to_numpy(std::move(mesh.labels)), to_numpy(std::move(mesh.faces)));
}

/// Moved vertices and the fields of the moved skeleton; None if the torso is missing.
VerticesAndSkeleton animate_vertices(const CArray<float>& vertices, const Bytes& labels,
                                     const PySkeleton& skeleton, const PySkeleton& pose,
                                     PoseScope scope, Skinning method) {
  const auto from = rows<Rows<float, 3>>(vertices, "vertices");
  if (labels.ndim() != 1 || labels.shape(0) != from.rows()) {
    throw InputError("labels: expected shape (" + std::to_string(from.rows()) + ",)");
  }
  for (py::ssize_t i = 0; i < labels.shape(0); ++i) {
    if (labels.data()[i] < 1 || labels.data()[i] >= kNumJoints) {
      throw InputError("labels: expected 1 to 24, got " + std::to_string(labels.data()[i]));
    }
  }
  const Skeleton source = to_skeleton(skeleton), target = to_skeleton(pose);
  Rows<float, 3> to(from.rows(), 3);
  std::optional<BoneMotions> motions;
  {
    const py::gil_scoped_release nogil;
    motions = follow_pose(source, target, scope);
    if (motions) {
      animate(from.data(), labels.data(), from.rows(), source, *motions, method, to.data());
    }
  }
  if (!motions) return py::none();
  return py::make_tuple(to_numpy(std::move(to)), from_skeleton(move_skeleton(source, *motions)));
}

std::optional<Registration> optional_registration(const OptionalPyRegistration& registration) {
  if (registration.is_none()) return {};
  return to_registration(registration);
}

py::typing::Tuple<CArray<std::uint16_t>, Bytes, std::optional<Bytes>> composite_person(
    const CArray<float>& vertices, const CArray<std::int32_t>& faces, const CArray<float>& seen,
    const CArray<std::int32_t>& pixels, const std::optional<Bytes>& person_color,
    const OptionalPyRegistration& person_registration, bool in_place,
    const CArray<std::uint16_t>& depth, const PyIntrinsics& camera,
    const std::optional<Bytes>& color, const OptionalPyRegistration& registration,
    const CompositeOptions& options) {
  const auto at = rows<Rows<float, 3>>(vertices, "vertices");
  const auto from = rows<Rows<float, 3>>(seen, "seen");
  const auto triangles = rows<Rows<std::int32_t, 3>>(faces, "faces");
  const auto where = rows<Rows<std::int32_t, 2>>(pixels, "pixels");
  if (from.rows() != at.rows() || where.rows() != at.rows()) {
    throw InputError("seen, pixels: expected as many rows as vertices");
  }
  check_image(depth, 0, "depth");
  py::object keep;
  PersonSurface person{at.rows(),
                       triangles.rows(),
                       at.data(),
                       triangles.data(),
                       from.data(),
                       where.data(),
                       color_view(person_color, "person_color"),
                       optional_registration(person_registration),
                       in_place};
  const SceneView scene{depth.shape(0),
                        depth.shape(1),
                        depth.data(),
                        to_intrinsics(camera, keep),
                        color_view(color, "color"),
                        optional_registration(registration)};
  CArray<std::uint16_t> depth_out({depth.shape(0), depth.shape(1)});
  Bytes mask({depth.shape(0), depth.shape(1)});
  py::object color_out = py::none();
  CompositeBuffers out{depth_out.mutable_data(), mask.mutable_data(), nullptr};
  if (color) {
    Bytes image({color->shape(0), color->shape(1), py::ssize_t{3}});
    out.color = image.mutable_data();
    color_out = image;
  }
  {
    const py::gil_scoped_release nogil;
    composite(person, scene, options, out);
  }
  return py::make_tuple(depth_out, mask, color_out);
}

py::array noise_of_regions(const py::array& depth, const DepthNoiseOptions& options) {
  const DepthView view = depth_view(depth);
  std::vector<double> means;
  {
    const py::gil_scoped_release nogil;
    means = depth_noise(view, options);
  }
  return to_numpy(std::move(means));
}

/// (n, 8): row, begin, end, object, left gap, right gap, left sharp, right sharp.
py::array spans_of(const py::array& depth, double focal, double min_relief) {
  const DepthView view = depth_view(depth);
  Rows<std::int32_t, 8> table;
  {
    const py::gil_scoped_release nogil;
    const std::vector<SilhouetteSpan> spans = silhouette_spans(view, focal, min_relief);
    table.resize(static_cast<Eigen::Index>(spans.size()), 8);
    for (std::size_t i = 0; i < spans.size(); ++i) {
      const SilhouetteSpan& s = spans[i];
      table.row(static_cast<Eigen::Index>(i)) << s.row, s.begin, s.end, s.object, s.left_gap,
          s.right_gap, s.left_sharp ? 1 : 0, s.right_sharp ? 1 : 0;
    }
  }
  return to_numpy(std::move(table));
}

}  // namespace

void bind_streams(py::module_& m) {
  py::native_enum<PoseScope>(m, "PoseScope", "enum.Enum")
      .value("LIMBS", PoseScope::kLimbs)
      .value("BODY", PoseScope::kBody)
      .finalize();
  py::native_enum<Skinning>(m, "Skinning", "enum.Enum")
      .value("SPHERICAL", Skinning::kSpherical)
      .value("RIGID", Skinning::kRigid)
      .value("LBS", Skinning::kLbs)
      .finalize();
  py::native_enum<CompositeSurface>(m, "CompositeSurface", "enum.Enum")
      .value("MESH", CompositeSurface::kMesh)
      .value("POINTS", CompositeSurface::kPoints)
      .finalize();
  py::class_<DepthStepOptions>(m, "DepthStepOptions")
      .def(py::init<>())
      .def_readwrite("max_step", &DepthStepOptions::max_step);
  py::class_<RegionOptions>(m, "RegionOptions")
      .def(py::init<>())
      .def_readwrite("step", &RegionOptions::step)
      .def_readwrite("reach", &RegionOptions::reach)
      .def_readwrite("line_seeds", &RegionOptions::line_seeds);
  py::class_<AnimationMeshOptions>(m, "AnimationMeshOptions")
      .def(py::init<>())
      .def_readwrite("step", &AnimationMeshOptions::step)
      .def_readwrite("by_label", &AnimationMeshOptions::by_label)
      .def_readwrite("joint_reach", &AnimationMeshOptions::joint_reach);
  py::class_<CompositeOptions>(m, "CompositeOptions")
      .def(py::init<>())
      .def_readwrite("surface", &CompositeOptions::surface)
      .def_readwrite("fill_pinholes", &CompositeOptions::fill_pinholes)
      .def_readwrite("blend", &CompositeOptions::blend);
  py::class_<DepthNoiseOptions>(m, "DepthNoiseOptions")
      .def(py::init<>())
      .def_readwrite("region", &DepthNoiseOptions::region)
      .def_readwrite("sigma", &DepthNoiseOptions::sigma);
  m.def("depth_noise", &noise_of_regions, py::arg("depth"), py::arg("options"));
  m.def("silhouette_spans", &spans_of, py::arg("depth"), py::arg("focal"), py::arg("min_relief"));
  m.def("segment_region", &segment_region, py::arg("depth"), py::arg("body_index").noconvert(),
        py::arg("camera"), py::arg("skeleton"), py::arg("mask"), py::arg("options"));
  m.def("without_speckles", &without_speckles, py::arg("depth").noconvert(),
        py::arg("labels").noconvert());
  m.def("animation_mesh", &make_animation_mesh, py::arg("depth"), py::arg("labels").noconvert(),
        py::arg("camera"), py::arg("skeleton"), py::arg("options"));
  m.def("animate", &animate_vertices, py::arg("vertices").noconvert(),
        py::arg("labels").noconvert(), py::arg("skeleton"), py::arg("pose"), py::arg("scope"),
        py::arg("method"));
  m.def("composite", &composite_person, py::arg("vertices").noconvert(),
        py::arg("faces").noconvert(), py::arg("seen").noconvert(), py::arg("pixels").noconvert(),
        py::arg("person_color").noconvert(), py::arg("person_registration"), py::arg("in_place"),
        py::arg("depth").noconvert(), py::arg("camera"), py::arg("color").noconvert(),
        py::arg("registration"), py::arg("options"));
}

}  // namespace manip3d::bindings
