#include <algorithm>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "interruptible.hpp"
#include "manip3d/geometry/point_cloud.hpp"
#include "manip3d/io/point_file.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "paths.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

// NumPy's type names, in the order of FieldType.
constexpr const char* kTypeNames[] = {"<i1", "<u1", "<i2", "<u2", "<i4",
                                      "<u4", "<i8", "<u8", "<f4", "<f8"};

FieldType field_type(const std::string& name) {
  const auto* found = std::find(std::begin(kTypeNames), std::end(kTypeNames), name);
  if (found == std::end(kTypeNames)) {
    throw InputError("fields: expected a type such as '<f4', got '" + name + "'");
  }
  return static_cast<FieldType>(found - std::begin(kTypeNames));
}

// (name, type, values per point)
using FieldList = py::typing::List<py::typing::Tuple<py::str, py::str, std::int64_t>>;
// (key, value)
using Header = py::typing::List<py::typing::Tuple<py::str, py::str>>;

FieldList to_list(const std::vector<PointField>& fields) {
  FieldList list;
  for (const PointField& field : fields) {
    list.append(py::make_tuple(readable(field.name), kTypeNames[static_cast<int>(field.type)],
                               field.count));
  }
  return list;
}

Header to_list(const PointHeader& header) {
  Header list;
  for (const auto& [key, value] : header) {
    list.append(py::make_tuple(key, py::str(readable(value))));
  }
  return list;
}

PointHeader to_header(const Header& list) {
  PointHeader header;
  for (const py::handle& item : list) {
    const auto entry = py::cast<py::tuple>(item);
    header.emplace_back(py::cast<std::string>(entry[0]), py::cast<std::string>(entry[1]));
  }
  return header;
}

std::vector<PointField> to_fields(const FieldList& list) {
  std::vector<PointField> fields;
  for (const py::handle& item : list) {
    const auto entry = py::cast<py::tuple>(item);
    fields.push_back({py::cast<std::string>(entry[0]), field_type(py::cast<std::string>(entry[1])),
                      py::cast<std::int64_t>(entry[2])});
  }
  return fields;
}

}  // namespace

void bind_scans(py::module_& m) {
  m.def(
      "check_points",
      [](const CArray<float>& points, const CArray<float>& intensity) {
        const PointsView view(rows<Points>(points, "points"),
                              rows<Intensities>(intensity, "intensity"));
        const py::gil_scoped_release nogil;
        check_points(view);
      },
      py::arg("points").noconvert(), py::arg("intensity").noconvert());
  m.def(
      "read_points",
      [](const py::bytes& path, std::uint64_t max_bytes, const PyProgress& progress) {
        const auto file = to_path(path, "path");
        PointTable table;
        {
          const py::gil_scoped_release nogil;
          table = read_points(file, ReadPointsOptions{max_bytes}, interruptible(progress));
        }
        const FieldList fields = to_list(table.fields);
        const Header header = to_list(table.header);
        return py::make_tuple(point_format_name(table.format), fields, header, table.num_points,
                              to_numpy(std::move(table.rows)));
      },
      py::arg("path"), py::arg("max_bytes"), py::arg("progress") = py::none());
  m.def(
      "write_points",
      [](const py::bytes& path, const FieldList& fields, const Header& header,
         std::int64_t num_points, const CArray<char>& bytes) {
        const auto file = to_path(path, "path");
        const PointTableView table{to_fields(fields),
                                   to_header(header),
                                   num_points,
                                   {bytes.data(), static_cast<std::size_t>(bytes.size())}};
        const py::gil_scoped_release nogil;
        write_points(file, table, interruptible());
      },
      py::arg("path"), py::arg("fields"), py::arg("header"), py::arg("num_points"),
      py::arg("bytes").noconvert());
  m.def("point_suffixes", [] {
    py::typing::List<py::str> list;
    for (const std::string& suffix : point_suffixes()) list.append(suffix);
    return list;
  });
}

}  // namespace manip3d::bindings
