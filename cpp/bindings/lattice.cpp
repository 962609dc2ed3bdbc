#include "manip3d/authenticate/lattice.hpp"

#include <pybind11/stl.h>
#include <pybind11/typing.h>

#include <cstdint>
#include <numbers>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "interruptible.hpp"
#include "manip3d/authenticate/generic.hpp"
#include "manip3d/authenticate/reflectance.hpp"
#include "manip3d/authenticate/reflectance_contrast.hpp"
#include "manip3d/authenticate/turns.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "numpy.hpp"
#include "points.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

// Slope, offset, lateral, azimuth, range phase, center, slope error.
using RingTable = Rows<double, 7>;

ScanLattice to_lattice(const CArray<double>& rings, int steps, double range_step,
                       double coordinate_step) {
  const auto table = rows<RingTable>(rings, "rings");
  ScanLattice lattice{{}, steps, 0.0, range_step, coordinate_step};
  if (steps > 0) lattice.azimuth_step = 2.0 * std::numbers::pi / steps;
  for (const auto& row : table.rowwise()) {
    lattice.rings.push_back({row[0], row[1], row[2], row[3], row[4], row[5], row[6]});
  }
  return lattice;
}

// Ring, count, azimuth, line error, step error, range error.
using Reading = std::tuple<CArray<std::int32_t>, CArray<std::int32_t>, CArray<float>, CArray<float>,
                           CArray<float>, CArray<float>>;

LatticeReading to_reading(const Reading& reading) {
  return {rows<Indices>(std::get<0>(reading), "ring"),
          rows<Indices>(std::get<1>(reading), "count"),
          rows<Eigen::VectorXf>(std::get<2>(reading), "azimuth"),
          rows<Eigen::VectorXf>(std::get<3>(reading), "line_error"),
          rows<Eigen::VectorXf>(std::get<4>(reading), "step_error"),
          rows<Eigen::VectorXf>(std::get<5>(reading), "range_error")};
}

auto to_tuple(LatticeReading&& reading) {
  return py::make_tuple(
      to_numpy(std::move(reading.ring)), to_numpy(std::move(reading.count)),
      to_numpy(std::move(reading.azimuth)), to_numpy(std::move(reading.line_error)),
      to_numpy(std::move(reading.step_error)), to_numpy(std::move(reading.range_error)));
}

constexpr const char* kDroppedNames[] = {"",        "unknown",   "contradicted",
                                         "depends", "no ground", "no previous"};

py::list to_list(const std::array<EvidenceReport, kNumEvidence>& evidence) {
  py::list list;
  for (const EvidenceReport& report : evidence) {
    list.append(py::make_tuple(kDroppedNames[static_cast<int>(report.dropped)], report.share,
                               report.strength));
  }
  return list;
}

py::list to_list(const std::vector<SuspectRegion>& regions) {
  py::list list;
  for (const SuspectRegion& region : regions) {
    list.append(py::make_tuple(region.strength,
                               std::array{region.lower.x(), region.lower.y(), region.lower.z()},
                               std::array{region.upper.x(), region.upper.y(), region.upper.z()}));
  }
  return list;
}

constexpr const char* kTurnEvidenceNames[] = {"lost", "through", "before"};

py::list to_list(std::vector<TurnRegion>&& regions) {
  py::list list;
  for (TurnRegion& region : regions) {
    Fields fields;
    fields["kind"] = py::str(kTurnEvidenceNames[static_cast<int>(region.kind)]);
    fields["cells"] = region.cells;
    fields["agreed"] = region.agreed;
    fields["ground"] = region.ground;
    fields["moved"] = region.moved;
    fields["distance"] = region.distance;
    fields["stood"] = to_numpy(std::move(region.stood));
    fields["rows"] = to_numpy(std::move(region.rows));
    list.append(std::move(fields));
  }
  return list;
}

constexpr const char* kReflectanceNames[] = {"even", "changed"};

/// Kind, strength, rows.
using ReflectanceTuple = py::typing::Tuple<py::str, double, py::array_t<std::int32_t>>;

py::typing::List<ReflectanceTuple> to_list(std::vector<ReflectanceRegion>&& regions) {
  py::list list;
  for (ReflectanceRegion& region : regions) {
    list.append(py::make_tuple(kReflectanceNames[static_cast<int>(region.kind)], region.strength,
                               to_numpy(std::move(region.rows))));
  }
  return list;
}

ScanMotion to_motion(const CArray<double>& matrix, const char* name) {
  const auto table = rows<Rows<double, 4>>(matrix, name);
  if (table.rows() != 4) throw InputError(std::string(name) + ": expected 4 rows");
  ScanMotion motion;
  motion.rotation = table.topLeftCorner<3, 3>();
  motion.translation = table.topRightCorner<3, 1>();
  return motion;
}

Fields to_fields(const ScanMotion& motion) {
  Fields fields;
  fields["rotation"] = to_numpy(Eigen::Matrix<double, 3, 3, Eigen::RowMajor>(motion.rotation));
  fields["translation"] = to_numpy(Eigen::Vector3d(motion.translation));
  fields["residual"] = motion.residual;
  fields["pairs"] = motion.pairs;
  fields["tried"] = motion.tried;
  fields["found"] = motion.is_found();
  return fields;
}

}  // namespace

void bind_lattice(py::module_& m) {
  m.def(
      "read_lattice",
      [](const CArray<float>& points, const CArray<double>& rings, int steps, double range_step,
         double coordinate_step, int threads) {
        const PointsView view(rows<Points>(points, "points"));
        const ScanLattice lattice = to_lattice(rings, steps, range_step, coordinate_step);
        LatticeReading reading;
        {
          const py::gil_scoped_release nogil;
          reading = read_lattice(view, lattice, threads, interruptible());
        }
        return to_tuple(std::move(reading));
      },
      py::arg("points").noconvert(), py::arg("rings").noconvert(), py::arg("steps"),
      py::arg("range_step"), py::arg("coordinate_step"), py::arg("threads"));
  m.def(
      "generic_consistency",
      [](const CArray<float>& points, const CArray<double>& rings, int steps, double range_step,
         double coordinate_step, double tolerance, double range_incoherence, double azimuth_error,
         const CArray<float>& previous, const CArray<float>& following, int threads,
         const std::optional<Reading>& reading) {
        const PointsView view(rows<Points>(points, "points"));
        const ScanLattice lattice = to_lattice(rings, steps, range_step, coordinate_step);
        std::optional<LatticeReading> read;
        if (reading) read = to_reading(*reading);
        const PointsView earlier(rows<Points>(previous, "previous"));
        const PointsView later(rows<Points>(following, "following"));
        GenericOptions options;
        options.tolerance = tolerance;
        options.range_incoherence = range_incoherence;
        options.azimuth_error = azimuth_error;
        options.num_threads = threads;
        GenericResult result;
        {
          const py::gil_scoped_release nogil;
          result =
              read ? generic_consistency(view, lattice, std::move(*read), options, earlier, later,
                                         interruptible())
                   : generic_consistency(view, lattice, options, earlier, later, interruptible());
        }
        Fields fields;
        fields["evidence"] = to_list(result.evidence);
        fields["turns"] = result.num_turns;
        fields["directions"] = result.num_directions;
        fields["regions"] = to_list(result.regions);
        fields["flags"] = to_numpy(std::move(result.flags));
        fields["region_of_point"] = to_numpy(std::move(result.region_of_point));
        fields["cells"] = to_numpy(std::move(result.cells));
        return fields;
      },
      py::arg("points").noconvert(), py::arg("rings").noconvert(), py::arg("steps"),
      py::arg("range_step"), py::arg("coordinate_step"), py::arg("tolerance"),
      py::arg("range_incoherence"), py::arg("azimuth_error"), py::arg("previous").noconvert(),
      py::arg("following").noconvert(), py::arg("threads"), py::arg("reading") = py::none());
  m.def(
      "compare_turns",
      [](const CArray<float>& points, const CArray<float>& previous, const CArray<float>& following,
         const CArray<double>& rings, bool whole_turns, int threads,
         const std::optional<Reading>& reading) {
        const PointsView view(rows<Points>(points, "points"));
        const PointsView earlier(rows<Points>(previous, "previous"));
        const PointsView later(rows<Points>(following, "following"));
        const ScanLattice lattice = to_lattice(rings, 0, 0.0, 0.0);
        TurnOptions options;
        options.whole_turns = whole_turns;
        std::optional<LatticeReading> read;
        if (reading) read = to_reading(*reading);
        options.num_threads = threads;
        TurnResult result;
        {
          const py::gil_scoped_release nogil;
          result = read ? compare_turns(view, earlier, later, lattice, std::move(*read), options,
                                        interruptible())
                        : compare_turns(view, earlier, later, lattice, options, interruptible());
        }
        Fields fields;
        fields["judged"] = result.is_judged();
        fields["has_ground"] = result.has_ground;
        fields["previous"] = to_fields(result.previous);
        fields["following"] = to_fields(result.following);
        fields["regions"] = to_list(std::move(result.regions));
        fields["seen"] = py::make_tuple(to_tuple(std::move(result.seen[0])),
                                        to_tuple(std::move(result.seen[1])));
        return fields;
      },
      py::arg("points").noconvert(), py::arg("previous").noconvert(),
      py::arg("following").noconvert(), py::arg("rings").noconvert(), py::arg("whole_turns"),
      py::arg("threads"), py::arg("reading") = py::none());
  m.def(
      "compare_reflectance",
      [](const CArray<float>& points, const CArray<float>& reflectance, const CArray<double>& rings,
         const std::vector<CArray<float>>& turns, const std::vector<CArray<double>>& motions,
         int threads, const std::optional<Reading>& reading, const std::vector<Reading>& seen) {
        const PointsView view = points_view(points, reflectance);
        const ScanLattice lattice = to_lattice(rings, 0, 0.0, 0.0);
        std::optional<LatticeReading> read;
        if (reading) read = to_reading(*reading);
        const bool both = turns.size() == 4 && motions.size() == 2;
        if (!both && !turns.empty()) throw InputError("turns: expected two turns or none");
        const PointsView none;
        const PointsView earlier = both ? points_view(turns[0], turns[1]) : none;
        const PointsView later = both ? points_view(turns[2], turns[3]) : none;
        if (!seen.empty() && !(both && seen.size() == 2)) {
          throw InputError("seen: expected the readings of two turns or none");
        }
        std::vector<LatticeReading> moved;
        for (const Reading& each : seen) moved.push_back(to_reading(each));
        const ReflectanceTurn previous{earlier,
                                       both ? to_motion(motions[0], "previous") : ScanMotion{},
                                       moved.empty() ? nullptr : &moved[0]};
        const ReflectanceTurn following{later,
                                        both ? to_motion(motions[1], "following") : ScanMotion{},
                                        moved.empty() ? nullptr : &moved[1]};
        ReflectanceOptions options;
        options.num_threads = threads;
        std::vector<ReflectanceRegion> regions;
        {
          const py::gil_scoped_release nogil;
          const ReflectanceTurn* first = both ? &previous : nullptr;
          const ReflectanceTurn* second = both ? &following : nullptr;
          regions =
              read ? compare_reflectance(view, lattice, std::move(*read), first, second, options,
                                         interruptible())
                   : compare_reflectance(view, lattice, first, second, options, interruptible());
        }
        return to_list(std::move(regions));
      },
      py::arg("points").noconvert(), py::arg("reflectance").noconvert(),
      py::arg("rings").noconvert(), py::arg("turns"), py::arg("motions"), py::arg("threads"),
      py::arg("reading") = py::none(), py::arg("seen") = std::vector<Reading>());
  m.def(
      "reflectance_contrast",
      [](const CArray<float>& points, const CArray<float>& reflectance,
         const CArray<std::int32_t>& rings, const CArray<float>& azimuths,
         const std::vector<std::int64_t>& slips) {
        const PointsView view = points_view(points, reflectance);
        const auto ring = rows<Indices>(rings, "rings");
        const auto azimuth = rows<Eigen::VectorXf>(azimuths, "azimuths");
        const std::span lasers(ring.data(), static_cast<std::size_t>(ring.size()));
        const std::span directions(azimuth.data(), static_cast<std::size_t>(azimuth.size()));
        ReflectanceContrast found;
        {
          const py::gil_scoped_release nogil;
          found = reflectance_contrast(view, lasers, directions, slips);
        }
        return py::make_tuple(found.edges, found.surfaces, std::move(found.contrast));
      },
      py::arg("points").noconvert(), py::arg("reflectance").noconvert(),
      py::arg("rings").noconvert(), py::arg("azimuths").noconvert(), py::arg("slips"));
  m.attr("CELL_COLUMNS") = kCellColumns;
}

}  // namespace manip3d::bindings
