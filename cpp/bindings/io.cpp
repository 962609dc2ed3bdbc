#include <pybind11/stl.h>

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "interruptible.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "manip3d/io/range_grid.hpp"
#include "manip3d/io/temporary.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "paths.hpp"

namespace manip3d::bindings {
namespace {

py::list to_list(const std::vector<std::string>& strings) {
  py::list list;
  // Files hold any bytes; what is no UTF-8 is shown, not refused.
  for (const std::string& s : strings) list.append(readable(s));
  return list;
}

// (mesh, format, number of polygons, number of skipped items, warnings)
py::tuple to_tuple(ReadResult&& result) {
  const py::list warnings = to_list(result.warnings);
  return py::make_tuple(mesh_to_python(std::move(result.mesh)), format_name(result.format),
                        result.num_polygons, result.num_skipped, warnings);
}

ReadOptions read_options(bool allow_outside, std::uint64_t max_bytes) {
  ReadOptions options;
  options.allow_outside = allow_outside;
  options.max_bytes = max_bytes;
  return options;
}

}  // namespace

void bind_io(py::module_& m) {
  m.def(
      "read_mesh",
      [](const py::bytes& path, bool allow_outside, std::uint64_t max_bytes) {
        const auto file = to_path(path, "path");
        ReadResult result;
        {
          const py::gil_scoped_release nogil;
          result = read_mesh(file, read_options(allow_outside, max_bytes), interruptible());
        }
        return to_tuple(std::move(result));
      },
      py::arg("path"), py::arg("allow_outside"), py::arg("max_bytes"));
  m.def(
      "read_mesh_bytes",
      [](const py::bytes& data, const std::string& suffix, std::uint64_t max_bytes) {
        char* start = nullptr;
        py::ssize_t size = 0;
        if (PyBytes_AsStringAndSize(data.ptr(), &start, &size) != 0) throw py::error_already_set();
        const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(start),
                                               static_cast<std::size_t>(size));
        ReadResult result;
        {
          const py::gil_scoped_release nogil;
          result = read_mesh(bytes, format_of_suffix(suffix), read_options(false, max_bytes),
                             interruptible());
        }
        return to_tuple(std::move(result));
      },
      py::arg("data"), py::arg("suffix"), py::arg("max_bytes"));
  m.def(
      "write_mesh",
      [](const py::object& mesh, const py::bytes& path, const py::bytes& texture_folder,
         std::int64_t max_vertices, const py::list& coarser, const std::vector<double>& coverages) {
        const BorrowedMesh borrowed(mesh);
        std::vector<std::unique_ptr<BorrowedMesh>> levels;
        const std::vector<Material> materials = materials_of(mesh);
        const auto file = to_path(path, "path");
        WriteOptions options{
            to_path(texture_folder, "texture_folder"), max_vertices, {}, coverages};
        for (const py::handle level : coarser) {
          levels.push_back(
              std::make_unique<BorrowedMesh>(py::reinterpret_borrow<py::object>(level)));
          options.coarser.push_back(levels.back()->view());
        }
        std::vector<std::string> warnings;
        {
          const py::gil_scoped_release nogil;
          warnings = write_mesh(file, borrowed.view(), materials, options, interruptible());
        }
        return to_list(warnings);
      },
      py::arg("mesh"), py::arg("path"), py::arg("texture_folder"), py::arg("max_vertices"),
      py::arg("coarser"), py::arg("coverages"));
  m.def(
      "read_range_grid",
      [](const py::bytes& path, std::uint64_t max_bytes) {
        const auto file = to_path(path, "path");
        RangeGrid grid;
        {
          const py::gil_scoped_release nogil;
          grid = read_range_grid(file, read_options(false, max_bytes), interruptible());
        }
        return py::make_tuple(grid.num_rows, grid.num_cols, to_numpy(std::move(grid.vertex)),
                              to_numpy(std::move(grid.points)));
      },
      py::arg("path"), py::arg("max_bytes"));
  m.def(
      "resolve_inside",
      [](const py::bytes& folder, const py::bytes& reference) {
        return py::bytes(
            resolve_inside(to_path(folder, "folder"), to_path(reference, "reference").string())
                .string());
      },
      py::arg("folder"), py::arg("reference"));
  m.def(
      "make_temporary_folder",
      [](const py::bytes& folder) {
        const auto place = to_path(folder, "folder");
        Temporary made;
        {
          const py::gil_scoped_release nogil;
          made = make_temporary(place, TemporaryKind::kFolder, 0700);
        }
        return std::pair(py::bytes(made.path.string()), made.lock.release());
      },
      py::arg("folder"));
  m.def(
      "replace_folder",
      [](const py::bytes& made, const py::bytes& target) {
        replace_folder(to_path(made, "made"), to_path(target, "target"));
      },
      py::arg("made"), py::arg("target"));
  m.def("readable_suffixes", [] { return to_list(readable_suffixes()); });
  m.def("writable_suffixes", [] { return to_list(writable_suffixes()); });
}

}  // namespace manip3d::bindings
