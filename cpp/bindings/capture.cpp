#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <tuple>
#include <utility>

#include "exclusive.hpp"
#include "manip3d/capture/velodyne_source.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "paths.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

using Lasers = Rows<double, 8>;  // the members of LaserCalibration, in their order

VelodyneCalibration velodyne_calibration(const CArray<double>& array, double range_unit) {
  VelodyneCalibration calibration;
  calibration.range_unit_m = range_unit;
  const auto table = rows<Lasers>(array, "lasers");
  for (Eigen::Index i = 0; i < table.rows(); ++i) {
    const auto row = table.row(i);
    calibration.lasers.push_back(
        {row[0], row[1], row[2], row[3] != 0.0, row[4], row[5], row[6], row[7]});
  }
  return calibration;
}

std::optional<VelodyneModel> to_model(const std::string& name) {
  if (name.empty()) return std::nullopt;
  const auto model = velodyne_model_of_name(name);
  if (!model) {
    throw InputError("model: expected hdl64e, hdl32e, vlp16, vlp16-hires or vlp32c, got '" + name +
                     "'");
  }
  return model;
}

Fields to_fields(VelodyneFrame&& frame) {
  Fields fields;
  fields["model"] = velodyne_model_name(frame.model);
  fields["time_ns"] = frame.time_ns;
  fields["sensor_time"] = frame.sensor_time;
  fields["packets"] = frame.packets;
  fields["is_complete"] = frame.is_complete;
  fields["points"] = to_numpy(std::move(frame.points));
  fields["intensity"] = to_numpy(std::move(frame.intensity));
  fields["ring"] = to_numpy(std::move(frame.ring));
  fields["laser"] = to_numpy(std::move(frame.laser));
  fields["return_type"] = to_numpy(std::move(frame.return_type));
  fields["azimuth"] = to_numpy(std::move(frame.azimuth));
  fields["range"] = to_numpy(std::move(frame.range));
  fields["time"] = to_numpy(std::move(frame.time));
  return fields;
}

Counts to_counts(const VelodyneCounters& c) {
  Counts fields;
  fields["packets"] = c.packets;
  fields["position_packets"] = c.position_packets;
  fields["bad_length"] = c.bad_length;
  fields["unknown_product"] = c.unknown_product;
  fields["other_product"] = c.other_product;
  fields["unknown_return_mode"] = c.unknown_return_mode;
  fields["bad_time"] = c.bad_time;
  fields["bad_block_flag"] = c.bad_block_flag;
  fields["bad_azimuth"] = c.bad_azimuth;
  fields["backward_azimuth"] = c.backward_azimuth;
  fields["lost_packets"] = c.lost_packets;
  fields["no_return"] = c.no_return;
  fields["repeated_packets"] = c.repeated_packets;
  fields["duplicates"] = c.duplicates;
  fields["out_of_range"] = c.out_of_range;
  fields["points"] = c.points;
  fields["frames"] = c.frames;
  fields["overlong_frames"] = c.overlong_frames;
  return fields;
}

// The fields of the next frame; True: no frame in time; False: no more frames.
template <typename Source>
FieldsOrBool read_frame(Exclusive<Source>& self, int timeout_ms) {
  VelodyneFrame frame;
  const ReadStatus status = self.with([&](Source& source) {
    const py::gil_scoped_release nogil;
    return source.read(frame, std::chrono::milliseconds(timeout_ms));
  });
  if (status != ReadStatus::kFrame) return py::bool_(status == ReadStatus::kTimeout);
  return to_fields(std::move(frame));
}

}  // namespace

void bind_capture(py::module_& m) {
  py::class_<VelodyneOptions>(m, "VelodyneOptions")
      .def(py::init([](const std::string& model, const CArray<double>& lasers, double range_unit,
                       double cut_azimuth, bool interpolate_azimuth, double min_range,
                       double max_range) {
             VelodyneOptions options;
             options.model = to_model(model);
             options.calibration = velodyne_calibration(lasers, range_unit);
             options.cut_azimuth_deg = cut_azimuth;
             options.interpolate_azimuth = interpolate_azimuth;
             options.min_range_m = min_range;
             options.max_range_m = max_range;
             return options;
           }),
           py::arg("model"), py::arg("lasers").noconvert(), py::arg("range_unit"),
           py::arg("cut_azimuth"), py::arg("interpolate_azimuth"), py::arg("min_range"),
           py::arg("max_range"));
  py::class_<Exclusive<VelodynePcapSource>>(m, "VelodynePcapSource")
      .def(py::init([](const py::bytes& path, const VelodyneOptions& options, int port,
                       std::uint64_t max_bytes, const py::bytes& sensor) {
             const auto chosen = to_c_text(sensor, "sensor");
             const auto file = to_path(path, "path");
             const auto wanted =
                 port < 0 ? std::nullopt : std::optional(static_cast<std::uint16_t>(port));
             const py::gil_scoped_release nogil;
             return std::make_unique<Exclusive<VelodynePcapSource>>(file, options, wanted,
                                                                    max_bytes, chosen);
           }),
           py::arg("path"), py::arg("options"), py::arg("port"), py::arg("max_bytes"),
           py::arg("sensor"))
      .def("read", &read_frame<VelodynePcapSource>, py::arg("timeout_ms"))
      .def("counters", [](Exclusive<VelodynePcapSource>& self) {
        const auto [decoded, c, others] = self.with([](const VelodynePcapSource& source) {
          return std::tuple(source.counters(), source.file_counters(), source.other_sender());
        });
        Counts fields = to_counts(decoded);
        fields["file_packets"] = c.packets;
        fields["file_udp"] = c.udp;
        fields["file_other"] = c.other;
        fields["file_fragments"] = c.fragments;
        fields["file_cut_short"] = c.cut_short;
        fields["other_sender"] = others;
        return fields;
      });
  py::class_<Exclusive<VelodyneUdpSource>>(m, "VelodyneUdpSource")
      .def(py::init([](const py::bytes& address, std::uint16_t port, const py::bytes& sender,
                       std::size_t ring_packets, const VelodyneOptions& options) {
             return std::make_unique<Exclusive<VelodyneUdpSource>>(
                 UdpOptions{to_c_text(address, "address"), port, to_c_text(sender, "sender"),
                            ring_packets},
                 options);
           }),
           py::arg("address"), py::arg("port"), py::arg("sender"), py::arg("ring_packets"),
           py::arg("options"))
      .def("start",
           [](Exclusive<VelodyneUdpSource>& self) {
             const py::gil_scoped_release nogil;
             self.shared().start();
           })
      .def("stop",
           [](Exclusive<VelodyneUdpSource>& self) {
             const py::gil_scoped_release nogil;
             self.shared().stop();
           })
      .def("port", [](Exclusive<VelodyneUdpSource>& self) { return self.shared().port(); })
      .def("read", &read_frame<VelodyneUdpSource>, py::arg("timeout_ms"))
      .def("counters", [](Exclusive<VelodyneUdpSource>& self) {
        const auto [decoded, others] = self.with([](const VelodyneUdpSource& source) {
          return std::pair(source.counters(), source.other_sender());
        });
        Counts fields = to_counts(decoded);
        const UdpCounters c = self.shared().udp_counters();
        fields["udp_packets"] = c.packets;
        fields["udp_dropped"] = c.dropped;
        fields["udp_dropped_kernel"] = c.dropped_kernel;
        fields["udp_other_sender"] = c.other_sender + others;
        fields["udp_too_long"] = c.too_long;
        return fields;
      });
}

}  // namespace manip3d::bindings
