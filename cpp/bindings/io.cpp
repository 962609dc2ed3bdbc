#include <pybind11/stl.h>

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "interruptible.hpp"
#include "manip3d/files/temporary.hpp"
#include "manip3d/geometry/triangulate_polygon.hpp"
#include "manip3d/io/corner_colors.hpp"
#include "manip3d/io/mesh_file.hpp"
#include "manip3d/io/range_grid.hpp"
#include "manip3d/io/scene_file.hpp"
#include "mesh.hpp"
#include "modules.hpp"
#include "paths.hpp"
#include "python_types.hpp"

namespace manip3d::bindings {
namespace {

using RowMatrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

using Strings = py::typing::List<py::str>;
using MeshAndNotes = py::typing::Tuple<PyMesh, py::str, std::int64_t, std::int64_t, Strings>;
using SceneNodes = py::typing::List<
    py::typing::Tuple<py::str, int, int, py::array_t<double>, bool,
                      py::typing::Optional<py::array_t<double>>, int, py::array_t<double>>>;
using Joints = py::array_t<std::uint16_t, py::array::c_style | py::array::forcecast>;
using Floats = py::array_t<float, py::array::c_style | py::array::forcecast>;
/// Joints and weights (V, J), morph targets and their changes of normals (T, V, 3).
using DeformationTables = py::typing::Tuple<Joints, Floats, Floats, Floats>;
using SceneMeshes = py::typing::List<
    py::typing::Tuple<py::str, PyMesh, py::str, py::typing::Optional<DeformationTables>,
                      py::typing::Optional<Floats>, py::typing::Optional<Floats>>>;
using SceneTables = py::typing::Tuple<SceneNodes, SceneMeshes, py::bytes, py::bytes, Strings>;
using SurfaceTables =
    py::typing::Tuple<py::array_t<std::int32_t>, py::typing::List<Named<"manip3d.mesh.Material">>,
                      py::array_t<std::uint8_t>, py::str>;
using PyDraco = Named<
    "collections.abc.Callable[[bytes], tuple[numpy.ndarray, dict[int, numpy.ndarray]] | str]">;
using Level = py::typing::List<py::typing::Optional<
    py::typing::Tuple<PyMesh, py::typing::Optional<DeformationTables>, py::typing::Optional<Floats>,
                      py::typing::Optional<Floats>>>>;

Strings to_list(const std::vector<std::string>& strings) {
  Strings list;
  // Files may contain any bytes; text that is not UTF-8 is shown in escaped form, not refused.
  for (const std::string& s : strings) list.append(readable(s));
  return list;
}

// (mesh, format, number of polygons, number of skipped items, warnings)
MeshAndNotes to_tuple(ReadResult&& result) {
  const py::list warnings = to_list(result.warnings);
  return py::make_tuple(mesh_to_python(std::move(result.mesh)), format_name(result.format),
                        result.num_polygons, result.num_skipped, warnings);
}

DracoMesh::Attribute to_attribute(const py::handle& array) {
  const auto given = py::cast<py::array>(array);
  const auto rows = py::array_t<double, py::array::c_style | py::array::forcecast>(given);
  if (rows.ndim() != 2) throw InputError("draco: expected arrays of two dimensions");
  return {static_cast<int>(rows.shape(1)), given.dtype().kind() != 'f',
          std::vector<double>(rows.data(), rows.data() + rows.size())};
}

/// A decoder that calls `decode(stream)`, which returns (faces, {unique id: values}) or the text of
/// an error. It borrows the callable for the duration of a call, because copies are made without
/// the GIL.
DracoDecoder draco_decoder(const PyDraco& decode) {
  return [callable = py::handle(decode)](std::span<const std::byte> stream) {
    const py::gil_scoped_acquire gil;
    const py::object result =
        callable(py::bytes(reinterpret_cast<const char*>(stream.data()), stream.size()));
    if (py::isinstance<py::str>(result)) throw FormatError(py::cast<std::string>(result), {});
    const auto tables = py::cast<std::pair<py::array, py::dict>>(result);
    DracoMesh mesh;
    mesh.corners = to_attribute(tables.first.attr("reshape")(-1, 1));
    for (const auto& [id, values] : tables.second) {
      mesh.attributes.emplace(py::cast<std::uint32_t>(id), to_attribute(values));
    }
    return mesh;
  };
}

ReadOptions read_options(bool allow_outside, std::uint64_t max_bytes, const PyDraco& draco) {
  ReadOptions options;
  options.allow_outside = allow_outside;
  options.max_bytes = max_bytes;
  options.draco = draco_decoder(draco);
  return options;
}

/// (I, 4, 4); None: the node shows its mesh once.
py::object instances_of(const SceneNode& node) {
  if (!node.instances) return py::none();
  const auto count = static_cast<py::ssize_t>(node.instances->size());
  py::array_t<double> rows({count, py::ssize_t{4}, py::ssize_t{4}});
  for (py::ssize_t i = 0; i < count; ++i) {
    Eigen::Map<RowMatrix4>(rows.mutable_data(i, 0, 0)) = (*node.instances)[i];
  }
  return rows;
}

/// (T, V, 3) of the values; (0, V, 3) without values.
Floats target_rows(std::vector<float>&& values, const Deformation& deformation,
                   py::ssize_t num_vertices) {
  Floats rows({values.empty() ? py::ssize_t{0} : py::ssize_t{deformation.num_targets}, num_vertices,
               py::ssize_t{3}});
  std::copy(values.begin(), values.end(), rows.mutable_data());
  return rows;
}

py::object deformation_of(SceneMesh& mesh) {
  Deformation& given = mesh.deformation;
  if (given.empty()) return py::none();
  const py::ssize_t rows = mesh.mesh.vertices.rows();
  Joints joints({rows, py::ssize_t{given.num_influences}});
  Floats weights({rows, py::ssize_t{given.num_influences}});
  std::copy(given.joints.begin(), given.joints.end(), joints.mutable_data());
  std::copy(given.weights.begin(), given.weights.end(), weights.mutable_data());
  Floats targets = target_rows(std::move(given.targets), given, rows);
  Floats normals = target_rows(std::move(given.target_normals), given, rows);
  return py::make_tuple(joints, weights, targets, normals);
}

/// (V, S, 2); None: the mesh has at most one set of texture coordinates.
py::object more_texcoords_of(const SceneMesh& mesh) {
  const MoreTexcoords& given = mesh.more_texcoords;
  if (given.num_sets == 0) return py::none();
  Floats rows(
      {py::ssize_t{mesh.mesh.vertices.rows()}, py::ssize_t{given.num_sets}, py::ssize_t{2}});
  std::copy(given.values.begin(), given.values.end(), rows.mutable_data());
  return rows;
}

/// (V,); None: all colours of vertices are opaque.
py::object alphas_of(const SceneMesh& mesh) {
  if (mesh.alphas.empty()) return py::none();
  return Floats(std::ssize(mesh.alphas), mesh.alphas.data());
}

template <typename T>
std::span<const T> span_of(const py::array_t<T, py::array::c_style | py::array::forcecast>& array) {
  return {array.data(), static_cast<std::size_t>(array.size())};
}

/// Objects that a level of detail borrows for the duration of a call.
struct Borrowed {
  std::vector<std::unique_ptr<BorrowedMesh>> meshes;
  std::vector<py::object> arrays;
};

DeformationView borrow_deformation(const py::object& given, Borrowed& keep) {
  if (given.is_none()) return {};
  const auto [joints, weights, targets, normals] =
      py::cast<std::tuple<Joints, Floats, Floats, Floats>>(given);
  keep.arrays.insert(keep.arrays.end(), {joints, weights, targets, normals});
  return {joints.shape(1),  targets.shape(0), span_of(joints),
          span_of(weights), span_of(targets), span_of(normals)};
}

MoreTexcoordsView borrow_more_texcoords(const py::object& given, Borrowed& keep) {
  if (given.is_none()) return {};
  const auto rows = py::cast<Floats>(given);
  if (rows.ndim() != 3) throw InputError("more_texcoords: expected an array of three dimensions");
  keep.arrays.push_back(rows);
  return {rows.shape(1), span_of(rows)};
}

std::span<const float> borrow_alphas(const py::object& given, Borrowed& keep) {
  if (given.is_none()) return {};
  const auto rows = py::cast<Floats>(given);
  keep.arrays.push_back(rows);
  return span_of(rows);
}

// (nodes, meshes, document, buffer, warnings). A node is (name, parent, mesh, transform, is drawn,
// instances, joint, inverse bind matrix); a mesh is (name, mesh, why it is fixed, deformation,
// further texture coordinates, alpha of vertices).
SceneTables to_tuple(Scene&& scene) {
  const py::list materials = materials_to_python(scene.materials);
  py::list nodes, meshes;
  for (const SceneNode& node : scene.nodes) {
    nodes.append(py::make_tuple(
        readable(node.name), node.parent, node.mesh, to_numpy(RowMatrix4(node.transform)),
        node.is_drawn, instances_of(node), node.joint, to_numpy(RowMatrix4(node.inverse_bind))));
  }
  for (SceneMesh& mesh : scene.meshes) {
    const py::object deformation = deformation_of(mesh);
    const py::object more_texcoords = more_texcoords_of(mesh);
    const py::object alphas = alphas_of(mesh);
    meshes.append(py::make_tuple(readable(mesh.name),
                                 mesh_to_python(std::move(mesh.mesh), materials), mesh.fixed,
                                 deformation, more_texcoords, alphas));
  }
  return py::make_tuple(nodes, meshes, py::bytes(scene.document), py::bytes(scene.buffer),
                        to_list(scene.warnings));
}

/// The meshes of a level of detail, borrowed for the duration of a call; None: unchanged.
SceneLevel borrow_level(const Level& meshes, Borrowed& keep) {
  SceneLevel level;
  for (const py::handle mesh : meshes) {
    if (mesh.is_none()) {
      level.emplace_back(std::nullopt);
      continue;
    }
    const auto [triangles, deformation, more_texcoords, alphas] =
        py::cast<std::tuple<py::object, py::object, py::object, py::object>>(mesh);
    keep.meshes.push_back(std::make_unique<BorrowedMesh>(triangles));
    level.emplace_back(
        SceneTriangles{keep.meshes.back()->view(), borrow_deformation(deformation, keep),
                       borrow_more_texcoords(more_texcoords, keep), borrow_alphas(alphas, keep)});
  }
  return level;
}

void bind_scenes(py::module_& m) {
  m.def(
      "read_scene",
      [](const py::bytes& path, bool allow_outside, std::uint64_t max_bytes, const PyDraco& draco,
         const PyProgress& progress) {
        const auto file = to_path(path, "path");
        const ReadOptions options = read_options(allow_outside, max_bytes, draco);
        Scene scene;
        {
          const py::gil_scoped_release nogil;
          scene = read_scene(file, options, interruptible(progress));
        }
        return to_tuple(std::move(scene));
      },
      py::arg("path"), py::arg("allow_outside"), py::arg("max_bytes"), py::arg("draco"),
      py::arg("progress") = py::none());
  m.def(
      "write_scene",
      [](const py::bytes& path, const std::string& document, const std::string& buffer,
         const std::vector<Level>& levels, std::int64_t max_vertices,
         const std::vector<double>& coverages, bool quantize, bool hash_names) {
        const auto file = to_path(path, "path");
        Borrowed keep;
        const SceneLevel finest = borrow_level(levels.at(0), keep);
        SceneWriteOptions options{max_vertices, {}, coverages, quantize, hash_names};
        for (std::size_t i = 1; i < levels.size(); ++i) {
          options.coarser.push_back(borrow_level(levels[i], keep));
        }
        std::vector<std::string> warnings;
        {
          const py::gil_scoped_release nogil;
          warnings = write_scene(file, document, buffer, finest, options, interruptible());
        }
        return to_list(warnings);
      },
      py::arg("path"), py::arg("document"), py::arg("buffer"), py::arg("levels"),
      py::arg("max_vertices"), py::arg("coverages"), py::arg("quantize"), py::arg("hash_names"));
}

void bind_mesh_readers(py::module_& m) {
  m.def(
      "read_mesh",
      [](const py::bytes& path, bool allow_outside, std::uint64_t max_bytes, const PyDraco& draco,
         const PyProgress& progress) {
        const auto file = to_path(path, "path");
        const ReadOptions options = read_options(allow_outside, max_bytes, draco);
        ReadResult result;
        {
          const py::gil_scoped_release nogil;
          result = read_mesh(file, options, interruptible(progress));
        }
        return to_tuple(std::move(result));
      },
      py::arg("path"), py::arg("allow_outside"), py::arg("max_bytes"), py::arg("draco"),
      py::arg("progress") = py::none());
  m.def(
      "read_mesh_bytes",
      [](const py::bytes& data, const std::string& suffix, std::uint64_t max_bytes,
         const PyDraco& draco, const PyProgress& progress) {
        const ReadOptions options = read_options(false, max_bytes, draco);
        char* start = nullptr;
        py::ssize_t size = 0;
        if (PyBytes_AsStringAndSize(data.ptr(), &start, &size) != 0) throw py::error_already_set();
        const std::span<const std::byte> bytes(reinterpret_cast<const std::byte*>(start),
                                               static_cast<std::size_t>(size));
        ReadResult result;
        {
          const py::gil_scoped_release nogil;
          result = read_mesh(bytes, format_of_suffix(suffix), options, interruptible(progress));
        }
        return to_tuple(std::move(result));
      },
      py::arg("data"), py::arg("suffix"), py::arg("max_bytes"), py::arg("draco"),
      py::arg("progress") = py::none());
}

void bind_mesh_writer(py::module_& m) {
  m.def(
      "write_mesh",
      [](const PyMesh& mesh, const py::bytes& path, const py::bytes& texture_folder,
         std::int64_t max_vertices, bool quantize, const py::typing::List<PyMesh>& coarser,
         const std::vector<double>& coverages, bool hash_names) {
        const BorrowedMesh borrowed(mesh);
        std::vector<std::unique_ptr<BorrowedMesh>> levels;
        const std::vector<Material> materials = materials_of(mesh);
        const auto file = to_path(path, "path");
        WriteOptions options{to_path(texture_folder, "texture_folder"),
                             max_vertices,
                             quantize,
                             {},
                             coverages,
                             hash_names};
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
      py::arg("quantize"), py::arg("coarser"), py::arg("coverages"), py::arg("hash_names"));
}

void bind_range_grid(py::module_& m) {
  m.def(
      "read_range_grid",
      [](const py::bytes& path, std::uint64_t max_bytes, const PyProgress& progress) {
        const auto file = to_path(path, "path");
        ReadOptions options;
        options.max_bytes = max_bytes;
        RangeGrid grid;
        {
          const py::gil_scoped_release nogil;
          grid = read_range_grid(file, options, interruptible(progress));
        }
        return py::make_tuple(grid.num_rows, grid.num_cols, to_numpy(std::move(grid.vertex)),
                              to_numpy(std::move(grid.points)), to_numpy(std::move(grid.colors)));
      },
      py::arg("path"), py::arg("max_bytes"), py::arg("progress") = py::none());
}

void bind_places(py::module_& m) {
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
}

void bind_surfaces(py::module_& m) {
  m.def("linear_color", &linear_color, py::arg("rgb"));
  m.def(
      "surface_colors",
      [](const PyMesh& mesh, const CArray<std::int32_t>& corner_colors) -> SurfaceTables {
        const BorrowedMesh borrowed(mesh);
        const auto num_materials = static_cast<std::int32_t>(py::len(mesh.attr("materials")));
        SurfaceColors found = surface_colors(borrowed.view(), num_materials,
                                             rows<Faces>(corner_colors, "corner_colors"));
        return py::make_tuple(to_numpy(std::move(found.face_material)),
                              materials_to_python(found.materials),
                              to_numpy(std::move(found.colors)), found.warning);
      },
      py::arg("mesh"), py::arg("corner_colors").noconvert());
  m.def(
      "triangulate_polygons",
      [](const CArray<double>& vertices, const CArray<std::int32_t>& corners,
         const CArray<std::int32_t>& counts) {
        const auto numbers = [](const CArray<std::int32_t>& array, const char* name) {
          const auto map = rows<Eigen::VectorX<std::int32_t>>(array, name);
          return std::span<const std::int32_t>(map.data(), static_cast<std::size_t>(map.size()));
        };
        return to_numpy(triangulate_polygons(rows<Vertices>(vertices, "vertices"),
                                             numbers(corners, "corners"),
                                             numbers(counts, "counts")));
      },
      py::arg("vertices").noconvert(), py::arg("corners").noconvert(),
      py::arg("counts").noconvert());
}

}  // namespace

void bind_io(py::module_& m) {
  bind_scenes(m);
  bind_mesh_readers(m);
  bind_mesh_writer(m);
  bind_range_grid(m);
  bind_places(m);
  bind_surfaces(m);
  m.def("readable_suffixes", [] { return to_list(readable_suffixes()); });
  m.def("writable_suffixes", [] { return to_list(writable_suffixes()); });
}

}  // namespace manip3d::bindings
