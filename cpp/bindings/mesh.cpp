#include "mesh.hpp"

#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <string>

namespace manip3d::bindings {
namespace {

template <typename Matrix>
Eigen::Map<const Matrix> borrow(const py::object& mesh, const char* name,
                                std::vector<py::object>& keep) {
  using Scalar = typename Matrix::Scalar;
  const py::object attribute = mesh.attr(name);
  if (attribute.is_none()) {
    return Eigen::Map<const Matrix>(nullptr, 0, Matrix::ColsAtCompileTime);
  }
  if (!py::isinstance<CArray<Scalar>>(attribute)) {
    throw InputError(std::string(name) + ": expected a C-contiguous array of " +
                     py::str(py::dtype::of<Scalar>()).cast<std::string>() + ", got " +
                     py::repr(py::type::of(attribute)).cast<std::string>());
  }
  keep.push_back(attribute);
  return rows<Matrix>(attribute.cast<CArray<Scalar>>(), name);
}

template <typename Matrix>
py::object optional_array(Matrix&& matrix) {
  if (matrix.rows() == 0) return py::none();
  return to_numpy(std::forward<Matrix>(matrix));
}

constexpr const char* kAlphaModes[] = {"opaque", "mask", "blend"};
constexpr const char* kWraps[] = {"repeat", "mirror", "clamp"};

const char* name_of(TextureWrap wrap) { return kWraps[static_cast<int>(wrap)]; }

py::object to_python(const Material& m) {
  const py::module_ types = py::module_::import("manip3d.mesh");
  py::dict textures;
  for (const auto& [role, texture] : m.textures) {
    py::object path = py::none();
    if (!texture.path.empty()) path = readable(texture.path);
    py::object data = py::none();
    if (!texture.data.empty()) {
      data = py::bytes(reinterpret_cast<const char*>(texture.data.data()), texture.data.size());
    }
    textures[py::str(role)] = types.attr("Texture")(
        py::arg("path") = path, py::arg("data") = data,
        py::arg("wrap") = py::make_tuple(name_of(texture.wrap[0]), name_of(texture.wrap[1])),
        py::arg("smooth") = texture.smooth);
  }
  return types.attr("Material")(
      py::arg("name") = readable(m.name),
      py::arg("base_color") =
          py::make_tuple(m.base_color[0], m.base_color[1], m.base_color[2], m.base_color[3]),
      py::arg("metallic") = m.metallic, py::arg("roughness") = m.roughness,
      py::arg("alpha_mode") = kAlphaModes[static_cast<int>(m.alpha_mode)],
      py::arg("alpha_cutoff") = m.alpha_cutoff, py::arg("double_sided") = m.double_sided,
      py::arg("textures") = textures,
      py::arg("emissive") = py::make_tuple(m.emissive[0], m.emissive[1], m.emissive[2]));
}

// The bytes of a text from readable().
std::string file_bytes(const py::handle& text) {
  const auto bytes = py::reinterpret_steal<py::bytes>(
      PyUnicode_AsEncodedString(text.ptr(), "utf-8", "surrogateescape"));
  if (!bytes) throw py::error_already_set();
  return bytes;
}

Material to_material(const py::handle& object) {
  Material m;
  m.name = file_bytes(object.attr("name"));
  const auto color = object.attr("base_color").cast<std::array<double, 4>>();
  std::copy(color.begin(), color.end(), m.base_color);
  const auto emissive = object.attr("emissive").cast<std::array<double, 3>>();
  std::copy(emissive.begin(), emissive.end(), m.emissive);
  m.metallic = object.attr("metallic").cast<double>();
  m.roughness = object.attr("roughness").cast<double>();
  const auto mode = object.attr("alpha_mode").cast<std::string>();
  for (int i = 0; i < 3; ++i) {
    if (mode == kAlphaModes[i]) m.alpha_mode = static_cast<AlphaMode>(i);
  }
  m.alpha_cutoff = object.attr("alpha_cutoff").cast<double>();
  m.double_sided = object.attr("double_sided").cast<bool>();
  for (const auto& [role, value] : object.attr("textures").cast<py::dict>()) {
    Texture& texture = m.textures[role.cast<std::string>()];
    if (!value.attr("path").is_none()) texture.path = file_bytes(value.attr("path"));
    if (!value.attr("data").is_none()) {
      const auto bytes = value.attr("data").cast<std::string>();
      texture.data.resize(bytes.size());
      std::memcpy(texture.data.data(), bytes.data(), bytes.size());
    }
    const auto wrap = value.attr("wrap").cast<std::array<std::string, 2>>();
    for (std::size_t side = 0; side < 2; ++side) {
      for (int i = 0; i < 3; ++i) {
        if (wrap[side] == kWraps[i]) texture.wrap[side] = static_cast<TextureWrap>(i);
      }
    }
    texture.smooth = value.attr("smooth").cast<bool>();
  }
  return m;
}

py::object make_mesh(TriangleMesh&& mesh, const py::object& materials,
                     const py::object& source = py::none()) {
  return py::module_::import("manip3d.mesh")
      .attr("Mesh")(to_numpy(std::move(mesh.vertices)), to_numpy(std::move(mesh.faces)),
                    py::arg("texcoords") = optional_array(std::move(mesh.texcoords)),
                    py::arg("face_texcoords") = optional_array(std::move(mesh.face_texcoords)),
                    py::arg("normals") = optional_array(std::move(mesh.normals)),
                    py::arg("face_normals") = optional_array(std::move(mesh.face_normals)),
                    py::arg("colors") = optional_array(std::move(mesh.colors)),
                    py::arg("face_material") = optional_array(std::move(mesh.face_material)),
                    py::arg("materials") = materials, py::arg("source") = source);
}

}  // namespace

BorrowedMesh::BorrowedMesh(const py::object& mesh) : view_(std::make_unique<MeshView>()) {
  const auto set = [&](auto& map, const char* name) {
    using Map = std::decay_t<decltype(map)>;
    using Matrix = typename Map::PlainObject;
    new (&map) Map(borrow<Matrix>(mesh, name, arrays_));  // Eigen's way to rebind a map
  };
  set(view_->vertices, "vertices");
  set(view_->faces, "faces");
  set(view_->texcoords, "texcoords");
  set(view_->face_texcoords, "face_texcoords");
  set(view_->normals, "normals");
  set(view_->face_normals, "face_normals");
  set(view_->colors, "colors");
  set(view_->face_material, "face_material");
}

py::str readable(const std::string& bytes) {
  // surrogateescape, as for file names: encoding returns the same bytes.
  PyObject* text =
      PyUnicode_DecodeUTF8(bytes.data(), static_cast<py::ssize_t>(bytes.size()), "surrogateescape");
  if (text == nullptr) throw py::error_already_set();
  return py::reinterpret_steal<py::str>(text);
}

std::vector<Material> materials_of(const py::object& mesh) {
  std::vector<Material> materials;
  for (const py::handle& object : mesh.attr("materials")) materials.push_back(to_material(object));
  return materials;
}

py::list materials_to_python(const std::vector<Material>& materials) {
  py::list list;
  for (const Material& m : materials) list.append(to_python(m));
  return list;
}

py::object mesh_to_python(TriangleMesh&& mesh) {
  const py::list materials = materials_to_python(mesh.materials);
  return make_mesh(std::move(mesh), materials);
}

py::object mesh_to_python(TriangleMesh&& mesh, const py::list& materials) {
  return make_mesh(std::move(mesh), materials);
}

py::object mesh_to_python(TriangleMesh&& mesh, const py::object& source) {
  return make_mesh(std::move(mesh), source.attr("materials"), source.attr("source"));
}

}  // namespace manip3d::bindings
