#include <pybind11/native_enum.h>
#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "array_pool.hpp"
#include "depth.hpp"
#include "exclusive.hpp"
#include "manip3d/modify/clothing.hpp"
#include "manip3d/modify/joint_smoother.hpp"
#include "manip3d/modify/key_person.hpp"
#include "manip3d/modify/mirror.hpp"
#include "manip3d/modify/phantom_pipeline.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "python_types.hpp"
#include "rgbd.hpp"

namespace manip3d::bindings {
namespace {

using People = py::typing::Iterable<PySkeleton>;
using PhantomArrays = Named<"manip3d.modify._phantom._Buffers">;

std::vector<Skeleton> to_skeletons(const People& people) {
  std::vector<Skeleton> skeletons;
  for (const py::handle person : people) skeletons.push_back(to_skeleton(person));
  return skeletons;
}

constexpr auto kNumShares = static_cast<py::ssize_t>(kNumHues + kNumShades);

std::vector<ClothingColors> to_clothes(const std::optional<CArray<float>>& rows) {
  std::vector<ClothingColors> clothes;
  if (!rows) return clothes;
  if (rows->ndim() != 2 || rows->shape(1) != kNumShares) {
    throw InputError("clothes: expected shape (N, " + std::to_string(kNumShares) + ")");
  }
  for (py::ssize_t i = 0; i < rows->shape(0); ++i) {
    std::copy_n(rows->data(i, 0), kNumShares, clothes.emplace_back().shares.begin());
  }
  return clothes;
}

void check_body_index(const CArray<std::uint8_t>& body_index, const DepthView& depth) {
  check_image(body_index, 0, "body_index");
  if (body_index.shape(0) != depth.rows || body_index.shape(1) != depth.cols) {
    throw InputError("body_index: expected the shape of depth");
  }
}

CArray<float> clothing_colors_of(const py::array& depth,
                                 const std::optional<CArray<std::uint8_t>>& body_index,
                                 const PyIntrinsics& camera,
                                 const OptionalPyRegistration& registration,
                                 const CArray<std::uint8_t>& color, const People& people) {
  py::object keep;
  const Intrinsics intrinsics = to_intrinsics(camera, keep);
  const PixelRays rays(intrinsics);
  std::optional<Registration> to_color;
  if (!registration.is_none()) to_color = to_registration(registration);
  const DepthView view = depth_view(depth);
  if (view.rows != intrinsics.height || view.cols != intrinsics.width) {
    throw InputError("depth: expected the size of its camera");
  }
  if (body_index) check_body_index(*body_index, view);
  const ColorView colors = color_view(color, "color");
  if (!to_color && (colors.rows != view.rows || colors.cols != view.cols)) {
    throw InputError("color: expected the size of depth where there is no registration");
  }
  const ColoredScene scene{view,  body_index ? body_index->data() : nullptr, &intrinsics,
                           &rays, to_color ? &*to_color : nullptr,           colors};
  const std::vector<Skeleton> skeletons = to_skeletons(people);
  CArray<float> rows({static_cast<py::ssize_t>(skeletons.size()), kNumShares});
  for (std::size_t i = 0; i < skeletons.size(); ++i) {
    const ClothingColors worn = clothing_colors(skeletons[i], scene);
    std::ranges::copy(worn.shares, rows.mutable_data(static_cast<py::ssize_t>(i), 0));
  }
  return rows;
}

/// The caller's image, to which the result is written.
template <typename T>
T* output(const py::object& out, const char* name, const std::vector<py::ssize_t>& shape) {
  const py::object array = out.attr(name);
  if (!py::isinstance<CArray<T>>(array)) {
    throw InputError(std::string("out.") + name + ": expected a C-contiguous array of the dtype");
  }
  auto typed = py::cast<CArray<T>>(array);
  const bool fits = typed.ndim() == static_cast<py::ssize_t>(shape.size()) &&
                    std::equal(shape.begin(), shape.end(), typed.shape());
  if (!fits || !typed.writeable()) {
    throw InputError(std::string("out.") + name + ": expected a writeable array of the shape");
  }
  return typed.mutable_data();
}

PhantomBuffers to_buffers(const py::object& out, py::ssize_t rows, py::ssize_t cols) {
  const auto capacity = out.attr("vertices").attr("shape")[py::int_(0)].cast<py::ssize_t>();
  PhantomBuffers buffers;
  buffers.depth = output<float>(out, "depth", {rows, cols});
  buffers.label = output<std::uint8_t>(out, "labels", {rows, cols});
  buffers.kind = reinterpret_cast<PixelKind*>(output<std::uint8_t>(out, "kinds", {rows, cols}));
  buffers.source = output<std::int32_t>(out, "source", {rows, cols, 2});
  buffers.mesh = {capacity, output<float>(out, "vertices", {capacity, 3}),
                  output<std::int32_t>(out, "pixels", {capacity, 2}),
                  output<float>(out, "texcoords", {capacity, 2}),
                  output<std::int32_t>(out, "faces", {2 * capacity, 3})};
  return buffers;
}

CArray<double> vector(const Eigen::Vector3d& v) {
  CArray<double> array(3);
  std::copy_n(v.data(), 3, array.mutable_data());
  return array;
}

Fields quality_fields(const PhantomQuality& quality) {
  Fields fields;
  fields["fit"] = py::float_(quality.fit);
  fields["hidden"] = py::float_(quality.hidden);
  fields["stature"] = py::float_(quality.stature);
  fields["offset"] = py::float_(quality.offset);
  fields["plane_deg"] = py::float_(quality.plane_deg);
  fields["across"] = py::float_(quality.across);
  fields["leap"] = py::float_(quality.leap);
  fields["gap"] = py::float_(quality.gap);
  fields["largest"] = py::float_(quality.largest);
  fields["lost"] = py::float_(quality.lost);
  fields["left"] = py::float_(quality.left);
  fields["cloth"] = py::float_(quality.cloth);
  fields["stray"] = py::float_(quality.stray);
  fields["outside"] = py::float_(quality.outside);
  fields["score"] = py::float_(quality.score);
  return fields;
}

Fields plane_fields(const BodyFrame& frame) {
  Fields fields;
  fields["origin"] = vector(frame.origin);
  fields["normal"] = vector(frame.n);
  return fields;
}

Fields to_fields(const PhantomReport& report) {
  py::typing::Dict<py::str, double> seconds;
  for (std::size_t i = 0; i < kNumPhantomStages; ++i) {
    seconds[kPhantomStageNames[i]] = report.seconds[i];
  }
  Fields fields;
  fields["state"] = py::cast(report.state);
  fields["reason"] = py::cast(report.reason);
  fields["opacity"] = py::float_(report.opacity);
  fields["visible"] = py::float_(report.visible);
  fields["quality"] = quality_fields(report.quality);
  fields["plane"] = report.plane ? py::object(plane_fields(*report.plane)) : py::none();
  fields["down"] = vector(report.down);
  fields["down_source"] = py::cast(report.down_source);
  fields["texture_number"] = py::int_(report.texture_number);
  fields["num_person"] = py::int_(report.num_person);
  fields["num_removed"] = py::int_(report.num_removed);
  fields["num_mirrored"] = py::int_(report.num_mirrored);
  fields["num_away"] = py::int_(report.num_away);
  fields["num_filled"] = py::int_(report.num_filled);
  fields["num_points"] = py::int_(report.num_points);
  fields["num_vertices"] = py::int_(report.mesh.num_vertices);
  fields["num_faces"] = py::int_(report.mesh.num_faces);
  fields["late_frames"] = py::int_(report.late_frames);
  fields["skeleton"] = from_skeleton(report.skeleton);
  fields["seconds"] = seconds;
  return fields;
}

/// A PhantomPipeline for arrays. It processes one frame at a time.
class PipelineRunner {
 public:
  explicit PipelineRunner(const PhantomOptions& options) : pipeline_(options) {}

  Fields process(const py::array& depth, const std::optional<CArray<std::uint8_t>>& body_index,
                 const PyIntrinsics& camera, const OptionalPyRegistration& registration,
                 const std::optional<CArray<std::uint8_t>>& colors, const People& people,
                 std::int64_t time_ns, std::int64_t number, const PhantomArrays& out) {
    PhantomInput input;
    input.depth = depth_view(depth);
    if (body_index) {
      check_body_index(*body_index, input.depth);
      input.body_index = body_index->data();
    }
    input.camera = to_intrinsics(camera, rays_);
    std::optional<Registration> color;
    if (!registration.is_none()) color = to_registration(registration);
    input.registration = color ? &*color : nullptr;
    input.color = color_view(colors, "color");
    const std::vector<Skeleton> skeletons = to_skeletons(people);
    input.people = skeletons;
    input.time_ns = time_ns;
    input.number = number;
    const PhantomBuffers buffers = to_buffers(out, input.depth.rows, input.depth.cols);
    PhantomReport report;
    {
      const py::gil_scoped_release nogil;
      report = pipeline_.process(input, buffers);
    }
    return to_fields(report);
  }

  void select(std::int64_t id) { pipeline_.select(id); }
  void reset() { pipeline_.reset(); }

 private:
  PhantomPipeline pipeline_;
  py::object rays_ = py::none();  ///< Ray table of the pipeline's latest camera.
};

void bind_enums(py::module_& m) {
  py::native_enum<Limb>(m, "Limb", "enum.Enum")
      .value("LEFT_ARM", Limb::kLeftArm)
      .value("RIGHT_ARM", Limb::kRightArm)
      .value("LEFT_LEG", Limb::kLeftLeg)
      .value("RIGHT_LEG", Limb::kRightLeg)
      .finalize();
  py::native_enum<MirrorMode>(m, "MirrorMode", "enum.Enum")
      .value("REFLECTION", MirrorMode::kReflection)
      .value("PAPER", MirrorMode::kPaper)
      .value("IMAGE", MirrorMode::kImage)
      .finalize();
  py::native_enum<PlaneRule>(m, "PlaneRule", "enum.Enum")
      .value("TRUNK", PlaneRule::kTrunk)
      .value("JOINTS", PlaneRule::kJoints)
      .finalize();
  py::native_enum<BoneRule>(m, "BoneRule", "enum.Enum")
      .value("SKIN", BoneRule::kSkin)
      .value("PAPER", BoneRule::kPaper)
      .finalize();
  py::native_enum<Texturing>(m, "Texturing", "enum.Enum")
      .value("SOURCE", Texturing::kSource)
      .value("CALIBRATION", Texturing::kCalibration)
      .finalize();
  py::native_enum<PhantomState>(m, "PhantomState", "enum.Enum")
      .value("TRACKING", PhantomState::kTracking)
      .value("DEGRADED", PhantomState::kDegraded)
      .value("HOLDING", PhantomState::kHolding)
      .value("FADING", PhantomState::kFading)
      .value("LOST", PhantomState::kLost)
      .value("LATE", PhantomState::kLate)
      .finalize();
  py::native_enum<DownSource>(m, "DownSource", "enum.Enum")
      .value("ASSUMED", DownSource::kAssumed)
      .value("POSTURE", DownSource::kPosture)
      .value("FLOOR", DownSource::kFloor)
      .finalize();
  py::native_enum<PhantomReason>(m, "PhantomReason", "enum.Enum")
      .value("NONE", PhantomReason::kNone)
      .value("NO_PERSON", PhantomReason::kNoPerson)
      .value("NO_PLANE", PhantomReason::kNoPlane)
      .value("OCCLUDED", PhantomReason::kOccluded)
      .value("INFERRED", PhantomReason::kInferred)
      .value("NO_SKELETON", PhantomReason::kNoSkeleton)
      .value("CALIBRATION", PhantomReason::kCalibration)
      .value("STOPPED", PhantomReason::kStopped)
      .value("SIDES", PhantomReason::kSides)
      .value("SHAKY", PhantomReason::kShaky)
      .value("LEAP", PhantomReason::kLeap)
      .value("DETACHED", PhantomReason::kDetached)
      .value("SHREDDED", PhantomReason::kShredded)
      .value("CUT", PhantomReason::kCut)
      .value("DOUBLED", PhantomReason::kDoubled)
      .value("CLOTH", PhantomReason::kCloth)
      .value("LATE", PhantomReason::kLate)
      .value("NO_JOINTS", PhantomReason::kNoJoints)
      .finalize();
}

void bind_joints(py::module_& m) {
  py::class_<JointSmootherOptions>(m, "JointSmootherOptions")
      .def(py::init<>())
      .def_static("seated", &JointSmootherOptions::seated)
      .def_readwrite("smoothing", &JointSmootherOptions::smoothing)
      .def_readwrite("correction", &JointSmootherOptions::correction)
      .def_readwrite("prediction", &JointSmootherOptions::prediction)
      .def_readwrite("jitter_radius", &JointSmootherOptions::jitter_radius)
      .def_readwrite("max_deviation", &JointSmootherOptions::max_deviation);
  py::class_<Exclusive<JointSmoother>>(m, "JointSmoother")
      .def(py::init<const JointSmootherOptions&>(), py::arg("options"))
      .def(
          "add",
          [](Exclusive<JointSmoother>& self, const PySkeleton& raw) -> Fields {
            const Skeleton skeleton = to_skeleton(raw);
            return from_skeleton(
                self.with([&](JointSmoother& smoother) { return smoother.add(skeleton); }));
          },
          py::arg("raw"))
      .def("reset", exclusively(&JointSmoother::reset));
  py::class_<KeyPersonOptions>(m, "KeyPersonOptions")
      .def(py::init<>())
      .def_readwrite("patience", &KeyPersonOptions::patience)
      .def_readwrite("reach", &KeyPersonOptions::reach)
      .def_readwrite("forget", &KeyPersonOptions::forget);
  py::class_<Exclusive<KeyPerson>>(m, "KeyPerson")
      .def(py::init<const KeyPersonOptions&>(), py::arg("options"))
      .def(
          "find",
          [](Exclusive<KeyPerson>& self, const People& people, const PyIntrinsics& camera,
             double time,
             const std::optional<CArray<float>>& clothes) -> std::optional<std::size_t> {
            py::object rays;
            const std::vector<Skeleton> skeletons = to_skeletons(people);
            const Intrinsics intrinsics = to_intrinsics(camera, rays);
            const std::vector<ClothingColors> worn = to_clothes(clothes);
            return self.with(
                [&](KeyPerson& key) { return key.find(skeletons, intrinsics, time, worn); });
          },
          py::arg("people"), py::arg("camera"), py::arg("time"), py::arg("clothes").noconvert())
      .def("select", exclusively(&KeyPerson::select), py::arg("id"))
      .def("reset", exclusively(&KeyPerson::reset));
}

void bind_pipeline(py::module_& m) {
  py::class_<PhantomMeshOptions>(m, "PhantomMeshOptions")
      .def(py::init<>())
      .def_readwrite("max_depth_step", &PhantomMeshOptions::max_depth_step)
      .def_readwrite("texturing", &PhantomMeshOptions::texturing);
  py::class_<PhantomOptions>(m, "PhantomOptions")
      .def(py::init<>())
      .def_readwrite("affected", &PhantomOptions::affected)
      .def_readwrite("mode", &PhantomOptions::mode)
      .def_readwrite("plane", &PhantomOptions::plane)
      .def_readwrite("smooths", &PhantomOptions::smooths)
      .def_readwrite("smoothing", &PhantomOptions::smoothing)
      .def_readwrite("mask", &PhantomOptions::mask)
      .def_readwrite("segmentation", &PhantomOptions::segmentation)
      .def_readwrite("arm_radius", &PhantomOptions::arm_radius)
      .def_readwrite("leg_radius", &PhantomOptions::leg_radius)
      .def_readwrite("root_radius", &PhantomOptions::root_radius)
      .def_readwrite("keep_residual", &PhantomOptions::keep_residual)
      .def_readwrite("least_visible", &PhantomOptions::least_visible)
      .def_readwrite("inferred_seconds", &PhantomOptions::inferred_seconds)
      .def_readwrite("hold_seconds", &PhantomOptions::hold_seconds)
      .def_readwrite("fade_seconds", &PhantomOptions::fade_seconds)
      .def_readwrite("mesh", &PhantomOptions::mesh);
  py::class_<ArrayPool>(m, "ArrayPool")
      .def(py::init<>())
      .def("empty", &ArrayPool::empty, py::arg("shape"), py::arg("dtype"));
  py::class_<Exclusive<PipelineRunner>>(m, "PhantomPipeline")
      .def(py::init<const PhantomOptions&>(), py::arg("options"))
      .def("process", exclusively(&PipelineRunner::process), py::arg("depth"),
           py::arg("body_index").noconvert(), py::arg("camera"), py::arg("registration"),
           py::arg("color").noconvert(), py::arg("people"), py::arg("time_ns"), py::arg("number"),
           py::arg("out"))
      .def("select", exclusively(&PipelineRunner::select), py::arg("id"))
      .def("reset", exclusively(&PipelineRunner::reset));
}

void bind_kernels(py::module_& m) {
  py::class_<PersonMaskOptions>(m, "PersonMaskOptions")
      .def(py::init<>())
      .def_readwrite("near", &PersonMaskOptions::near)
      .def_readwrite("far", &PersonMaskOptions::far)
      .def_readwrite("margin", &PersonMaskOptions::margin);
  m.def("clothing_colors", &clothing_colors_of, py::arg("depth"), py::arg("body_index").noconvert(),
        py::arg("camera"), py::arg("registration"), py::arg("color").noconvert(),
        py::arg("people"));
  m.def(
      "segment_person",
      [](const py::array& depth, const std::optional<CArray<std::uint8_t>>& body_index,
         const PyIntrinsics& camera, const PySkeleton& skeleton, const PersonMaskOptions& options,
         BoneRule rule) {
        const DepthView view = depth_view(depth);
        if (body_index) check_image(*body_index, 0, "body_index");
        py::object keep;
        const PixelRays rays(to_intrinsics(camera, keep));
        const Skeleton person = to_skeleton(skeleton);
        LabelImage image;
        {
          const py::gil_scoped_release nogil;
          PersonPoints points;
          find_person(view, body_index ? body_index->data() : nullptr, person, rays, options,
                      points);
          segment_bones(body_bones(person, rule), points);
          image = label_image(points);
        }
        return py::make_tuple(to_numpy(std::move(image.labels)),
                              to_numpy(std::move(image.distances)));
      },
      py::arg("depth"), py::arg("body_index").noconvert(), py::arg("camera"), py::arg("skeleton"),
      py::arg("options"), py::arg("rule"));
  m.def(
      "body_mirror",
      [](const PySkeleton& skeleton, Limb affected, MirrorMode mode) -> OptionalFields {
        const Skeleton person = to_skeleton(skeleton);
        const auto frame = body_frame(person, affected);
        if (!frame) return py::none();
        const Mirror mirror = make_mirror(*frame, mode);
        CArray<double> linear({3, 3});
        for (int i = 0; i < 9; ++i) linear.mutable_at(i / 3, i % 3) = mirror.linear(i / 3, i % 3);
        Fields fields;
        fields["linear"] = linear;
        fields["offset"] = vector(mirror.offset);
        fields["normal"] = vector(frame->n);
        fields["origin"] = vector(frame->origin);
        fields["skeleton"] = from_skeleton(with_mirrored_limb(person, affected, *frame, mirror));
        return fields;
      },
      py::arg("skeleton"), py::arg("affected"), py::arg("mode"));
}

}  // namespace

void bind_modify(py::module_& m) {
  bind_enums(m);
  bind_joints(m);
  bind_kernels(m);
  bind_pipeline(m);
}

}  // namespace manip3d::bindings
