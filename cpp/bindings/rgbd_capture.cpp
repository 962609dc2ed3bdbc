#include <pybind11/native_enum.h>
#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "exclusive.hpp"
#include "manip3d/capture/mkv.hpp"
#include "manip3d/capture/recorder.hpp"
#include "manip3d/capture/rgbd_source.hpp"
#include "modules.hpp"
#include "paths.hpp"
#include "python_types.hpp"
#include "rgbd.hpp"

namespace manip3d::bindings {
namespace {

using Source = Exclusive<std::unique_ptr<RgbdSource>>;
using Recorder = Exclusive<std::unique_ptr<RgbdRecorder>>;
using SharedCalibration = std::shared_ptr<const RgbdCalibration>;

// Returns the codec library in manip3d._mkv, which is imported when it is first needed.
FoundMkvCodec import_mkv() {
  const py::gil_scoped_acquire gil;
  try {
    const py::object table = py::module_::import("manip3d._mkv").attr("codec");
    return {table.cast<py::capsule>().get_pointer<const MkvCodec>(), "", ""};
  } catch (const py::error_already_set& error) {
    if (error.matches(PyExc_ModuleNotFoundError)) {
      return {nullptr, "manip3d._mkv is not built: FFmpeg's development files were not found",
              "apt-get install libavformat-dev libavcodec-dev libavutil-dev, then build again"};
    }
    if (!error.matches(PyExc_ImportError)) throw;
    return {nullptr, "manip3d._mkv: " + std::string(py::str(error.value())),
            "install the libraries of FFmpeg that manip3d was built with"};
  }
}

SharedCalibration shared_calibration(const OptionalPyCalibration& calibration) {
  if (calibration.is_none()) return nullptr;
  return std::make_shared<const RgbdCalibration>(to_calibration(calibration));
}

Fields camera_fields(const Intrinsics& camera) {
  Fields fields;
  fields["width"] = camera.width;
  fields["height"] = camera.height;
  fields["fx"] = camera.fx;
  fields["fy"] = camera.fy;
  fields["cx"] = camera.cx;
  fields["cy"] = camera.cy;
  fields["distortion"] = camera.distortion;
  fields["mirrored"] = camera.mirrored;
  if (camera.ray_table != nullptr) {
    fields["rays"] =
        py::array_t<float>({camera.height, camera.width, std::int64_t{2}}, camera.ray_table);
  }
  return fields;
}

// The fields of a manip3d.RgbdCalibration; None: the calibration is not known yet.
OptionalFields calibration_fields(const SharedCalibration& calibration) {
  if (!calibration) return py::none();
  Fields fields;
  fields["depth"] = camera_fields(calibration->depth);
  if (const auto& registration = calibration->registration) {
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rotation = registration->rotation;
    fields["color"] = camera_fields(registration->color);
    fields["rotation"] = py::array_t<double>({3, 3}, rotation.data());
    fields["translation"] = py::array_t<double>(3, registration->translation.data());
  }
  return fields;
}

// An image that takes over the vector's memory; None: the vector is empty.
template <typename T>
py::object image(std::vector<T>&& pixels, std::vector<py::ssize_t> shape) {
  if (pixels.empty()) return py::none();
  return to_numpy(std::move(pixels)).reshape(shape);
}

Fields frame_fields(RgbdFrame&& frame) {
  Fields fields;
  fields["depth"] = image(std::move(frame.depth), {frame.rows, frame.cols});
  fields["body_index"] = image(std::move(frame.body_index), {frame.rows, frame.cols});
  fields["color"] = image(std::move(frame.color), {frame.color_rows, frame.color_cols, 3});
  py::list skeletons;
  for (const Skeleton& skeleton : frame.skeletons) skeletons.append(from_skeleton(skeleton));
  fields["skeletons"] = std::move(skeletons);
  fields["time_ns"] = frame.time_ns;
  fields["number"] = frame.number;
  fields["grabbed_ns"] = frame.grabbed_ns;
  return fields;
}

Counts to_counts(const Counters& counters) {
  Counts fields;
  for (const auto& [name, count] : counters) fields[py::str(name)] = count;
  return fields;
}

Fields conversion_fields(const Conversions& conversions) {
  Fields fields;
  fields["flipped_depth"] = conversions.flipped_depth;
  fields["flipped_color"] = conversions.flipped_color;
  fields["assumed_rate"] = conversions.assumed_rate;
  return fields;
}

// The fields of the next frame; True: no frame in time; False: no more frames.
FieldsOrBool read(Source& self, int timeout_ms) {
  RgbdFrame frame;
  const ReadStatus status = self.with([&](const auto& source) {
    const py::gil_scoped_release nogil;
    return source->read(frame, std::chrono::milliseconds(timeout_ms));
  });
  if (status != ReadStatus::kFrame) return py::bool_(status == ReadStatus::kTimeout);
  return frame_fields(std::move(frame));
}

// Stops a source. Live sources end a waiting `read`; others do not wait, and are not stopped within
// a frame.
void stop(Source& self) {
  if (self.shared()->capabilities().is_live) {
    const py::gil_scoped_release nogil;
    self.shared()->stop();
  } else {
    self.with([](const auto& source) { source->stop(); });
  }
}

void bind_source(py::module_& m) {
  py::class_<Source>(m, "RgbdSource")
      .def("start",
           [](Source& self) {
             self.with([](const auto& source) {
               const py::gil_scoped_release nogil;
               source->start();
             });
           })
      .def("stop", &stop)
      .def("read", &read, py::arg("timeout_ms"))
      .def(
          "seek",
          [](Source& self, std::int64_t index) {
            self.with([&](const auto& source) {
              const py::gil_scoped_release nogil;
              source->seek(index);
            });
          },
          py::arg("index"))
      .def(
          "read_at",
          [](Source& self, std::int64_t index) {
            RgbdFrame frame;
            self.with([&](const auto& source) {
              const py::gil_scoped_release nogil;
              source->read_at(index, frame);
            });
            return frame_fields(std::move(frame));
          },
          py::arg("index"))
      .def("is_live", [](Source& self) { return self.shared()->capabilities().is_live; })
      .def("num_frames",
           [](Source& self) {
             return self.with([](const auto& source) { return source->num_frames(); });
           })
      .def("calibration",
           [](Source& self) {
             return calibration_fields(
                 self.with([](const auto& source) { return source->calibration(); }));
           })
      .def("conversions",
           [](Source& self) {
             return conversion_fields(
                 self.with([](const auto& source) { return source->conversions(); }));
           })
      .def("counters", [](Source& self) {
        return to_counts(self.with([](const auto& source) { return source->counters(); }));
      });
  m.def(
      "open_rgbd",
      [](const py::bytes& uri, double speed, double units_per_metre, double rate,
         const OptionalPyCalibration& camera) {
        const RgbdOptions options{speed, shared_calibration(camera), units_per_metre, rate};
        const std::string place = to_c_text(uri, "uri");
        const py::gil_scoped_release nogil;
        return std::make_unique<Source>(open_rgbd(place, options));
      },
      py::arg("uri"), py::arg("speed"), py::arg("units_per_metre"), py::arg("rate"),
      py::arg("camera"));
  m.def("rgbd_schemes", [] {
    std::vector<RgbdScheme> schemes;
    {
      const py::gil_scoped_release nogil;
      schemes = rgbd_schemes();
    }
    py::typing::List<Texts> list;
    for (const RgbdScheme& scheme : schemes) {
      Texts fields;
      fields["name"] = scheme.name;
      fields["location"] = scheme.location;
      fields["description"] = scheme.description;
      fields["reason"] = scheme.reason;
      fields["cure"] = scheme.cure;
      list.append(fields);
    }
    return list;
  });
}

void bind_recorder(py::module_& m) {
  py::native_enum<RecordingKind>(m, "RecordingKind", "enum.Enum")
      .value("folder", RecordingKind::kFolder)
      .value("mkv", RecordingKind::kMkv)
      .value("tum", RecordingKind::kTum)
      .finalize();
  py::class_<Recorder>(m, "RgbdRecorder")
      .def(
          "write",
          [](Recorder& self, const PyRgbdFrame& from) {
            RgbdFrame frame;
            to_frame(from, frame);
            self.with([&](const auto& recorder) {
              const py::gil_scoped_release nogil;
              recorder->write(frame);
            });
          },
          py::arg("frame"))
      .def("close",
           [](Recorder& self) {
             self.with([](const auto& recorder) {
               const py::gil_scoped_release nogil;
               recorder->close();
             });
           })
      .def("counters", [](Recorder& self) {
        return to_counts(self.with([](const auto& recorder) { return recorder->counters(); }));
      });
  m.def(
      "open_recorder",
      [](const py::bytes& path, const OptionalPyCalibration& calibration, bool lossless_color,
         int jpeg_quality, bool overwrite, std::optional<RecordingKind> kind) {
        const RecorderOptions options{kind, lossless_color, jpeg_quality, overwrite};
        const SharedCalibration cameras = shared_calibration(calibration);
        const std::filesystem::path place = to_path(path, "path");
        const py::gil_scoped_release nogil;
        return std::make_unique<Recorder>(open_recorder(place, cameras, options));
      },
      py::arg("path"), py::arg("calibration"), py::arg("lossless_color"), py::arg("jpeg_quality"),
      py::arg("overwrite"), py::arg("kind") = py::none());
}

}  // namespace

void bind_rgbd_capture(py::module_& m) {
  set_mkv_loader(&import_mkv);
  bind_source(m);
  bind_recorder(m);
}

}  // namespace manip3d::bindings
