#include <algorithm>
#include <set>
#include <string>
#include <vector>

#include "io/colors.hpp"
#include "io/formats.hpp"
#include "io/ply_header.hpp"
#include "io/texture_files.hpp"
#include "io/warnings.hpp"

namespace manip3d {
namespace {

template <typename Table>
bool fits_float(const Table& table) {
  return (table.array() == table.template cast<float>().template cast<double>().array()).all();
}

// The normal of each vertex if all its corners have the same one; empty if some do not.
Vertices vertex_normals(const MeshView& mesh, std::vector<std::string>& warnings) {
  if (mesh.face_normals.rows() == 0) return {};
  Vertices normals = Vertices::Zero(mesh.vertices.rows(), 3);
  std::vector<bool> known(mesh.vertices.rows(), false);
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const std::int32_t index = mesh.face_normals(f, c);
      const std::int32_t vertex = mesh.faces(f, c);
      const bool agrees =
          index >= 0 && (!known[vertex] || normals.row(vertex) == mesh.normals.row(index));
      if (!agrees) {
        warn(warnings, "PLY holds one normal per vertex: normals left out");
        return {};
      }
      normals.row(vertex) = mesh.normals.row(index);
      known[vertex] = true;
    }
  }
  return normals;
}

bool lacks_texcoords(const MeshView& mesh) {
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    if (!mesh.face_has_texcoords(f)) return true;
  }
  return false;
}

class PlyWriter {
 public:
  PlyWriter(Output& out, const WriteJob& job)
      : out_(out),
        job_(job),
        companions_(job),
        mesh_(job.mesh),
        normals_(vertex_normals(mesh_, job.warnings)),
        wide_positions_(!fits_float(mesh_.vertices)),
        some_lack_texcoords_(mesh_.has_texcoords() && lacks_texcoords(mesh_)) {}

  void write() {
    warn_of_losses();
    find_textures();
    if (mesh_.has_materials()) colors_ = colors_of(job_.materials);
    write_header();
    for (Eigen::Index i = 0; i < mesh_.vertices.rows(); ++i) write_vertex(i);
    for (Eigen::Index f = 0; f < mesh_.faces.rows(); ++f) write_face(f);
    companions_.commit(out_);
  }

 private:
  void warn_of_losses() {
    for (const Material& m : job_.materials) {
      if (m.alpha_mode != AlphaMode::kOpaque) warn(job_.warnings, "PLY: opacity left out");
      if (m.metallic != 0.0) warn(job_.warnings, "PLY: metallic left out");
      if (m.roughness != 1.0) warn(job_.warnings, "PLY: roughness left out");
      if (m.emits()) warn(job_.warnings, "PLY: emissive left out");
    }
  }

  void find_textures() {
    std::set<std::string> roles_left_out;
    for (const Material& m : job_.materials) {
      for (const auto& [role, texture] : m.textures) {
        if (role != "base_color" && roles_left_out.insert(role).second) {
          warn(job_.warnings, "PLY: textures of " + role + " left out");
        }
        if (role == "base_color" && !texture.has_usual_sampler()) {
          warn(job_.warnings, "PLY: samplers of textures left out; they repeat and are smoothed");
        }
      }
      const std::string name = companions_.texture_name(m, "base_color", true);
      texture_of_material_.push_back(-1);
      if (name.empty()) continue;
      const auto known = std::find(texture_names_.begin(), texture_names_.end(), name);
      texture_of_material_.back() = static_cast<std::int32_t>(known - texture_names_.begin());
      if (known == texture_names_.end()) texture_names_.push_back(name);
    }
  }

  void write_header() {
    out_.text("ply\nformat binary_little_endian 1.0\n");
    for (const std::string& name : texture_names_) out_.text("comment TextureFile " + name + "\n");
    for (std::size_t i = 0; i < job_.materials.size(); ++i) {
      out_.text(ply::material_comment(i, line_name(job_.materials[i].name)) + "\n");
    }
    const std::string position = wide_positions_ ? "property double " : "property float ";
    out_.text("element vertex " + std::to_string(mesh_.vertices.rows()) + "\n");
    for (const char* axis : {"x\n", "y\n", "z\n"}) out_.text(position + axis);
    if (normals_.rows() > 0) {
      for (const char* axis : {"nx\n", "ny\n", "nz\n"})
        out_.text("property double " + std::string(axis));
    }
    if (mesh_.colors.rows() > 0) {
      out_.text("property uchar red\nproperty uchar green\nproperty uchar blue\n");
    }
    out_.text("element face " + std::to_string(mesh_.faces.rows()) +
              "\nproperty list uchar int vertex_indices\n");
    if (mesh_.has_texcoords()) {
      // 32 bits, because MeshLab ignores a list of doubles.
      out_.text("property list uchar float texcoord\n");
    }
    if (some_lack_texcoords_) out_.text("property uchar has_texcoord\n");
    if (!texture_names_.empty()) out_.text("property int texnumber\n");
    if (mesh_.has_materials()) out_.text("property int material_index\n");
    if (!colors_.empty()) {
      out_.text("property uchar red\nproperty uchar green\nproperty uchar blue\n");
    }
    out_.text("end_header\n");
  }

  void real(double value, bool wide) {
    if (wide) {
      out_.binary(value);
    } else {
      out_.binary(static_cast<float>(value));
    }
  }

  void write_vertex(Eigen::Index i) {
    for (int k = 0; k < 3; ++k) real(mesh_.vertices(i, k), wide_positions_);
    for (int k = 0; normals_.rows() > 0 && k < 3; ++k) real(normals_(i, k), true);
    for (int k = 0; mesh_.colors.rows() > 0 && k < 3; ++k) out_.binary(mesh_.colors(i, k));
  }

  void write_face(Eigen::Index f) {
    out_.binary(std::uint8_t{3});
    for (int c = 0; c < 3; ++c) out_.binary(mesh_.faces(f, c));
    if (mesh_.has_texcoords()) write_texcoords(f);
    if (some_lack_texcoords_) out_.binary(std::uint8_t{mesh_.face_has_texcoords(f)});
    const std::int32_t material = mesh_.has_materials() ? mesh_.face_material[f] : -1;
    if (!texture_names_.empty()) {
      const std::size_t index = material;
      out_.binary(material >= 0 && index < texture_of_material_.size() ? texture_of_material_[index]
                                                                       : std::int32_t{-1});
    }
    if (mesh_.has_materials()) out_.binary(material);
    const std::int32_t rgb = color_of_face(mesh_, colors_, f);
    for (int k = 0; !colors_.empty() && k < 3; ++k) {
      out_.binary(static_cast<std::uint8_t>(channel(rgb, k)));  // -1 is written as white
    }
  }

  // All lists have the same length, because some readers (trimesh, VTK) refuse or garble a face
  // list with several lengths.
  void write_texcoords(Eigen::Index f) {
    const bool has = mesh_.face_has_texcoords(f);
    out_.binary(std::uint8_t{6});
    for (int c = 0; c < 3; ++c) {
      for (int k = 0; k < 2; ++k) {
        real(has ? mesh_.texcoords(mesh_.face_texcoords(f, c), k) : 0.0, false);
      }
    }
  }

  Output& out_;
  const WriteJob& job_;
  CompanionFiles companions_;
  const MeshView& mesh_;
  Vertices normals_;
  bool wide_positions_;
  bool some_lack_texcoords_;
  std::vector<std::string> texture_names_;
  std::vector<std::int32_t> texture_of_material_;
  std::vector<std::int32_t> colors_;  ///< Colours of the materials; empty: all are white.
};

}  // namespace

void write_ply(Output& output, const WriteJob& job) { PlyWriter(output, job).write(); }

}  // namespace manip3d
