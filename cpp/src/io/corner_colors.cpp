#include "manip3d/io/corner_colors.hpp"

#include <cmath>
#include <cstddef>
#include <string>
#include <unordered_map>

#include "io/colors.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int32_t kNone = -1;

// Limit of colours that become materials. People give parts fewer colours than this; scans have
// thousands.
constexpr std::size_t kMaxMaterials = 256;

constexpr std::int32_t kWhite = 0xFFFFFF;

using CornerColors = MeshView::Map<Faces>;

/// The colours of the faces that have a material in the mesh, or of those that have none.
Faces colors_of_faces(const MeshView& mesh, const CornerColors& colors, bool with_material) {
  Faces chosen = colors;
  for (Eigen::Index f = 0; f < chosen.rows(); ++f) {
    const bool has_material = mesh.has_materials() && mesh.face_material[f] != kNone;
    if (has_material != with_material) chosen.row(f).setConstant(kNone);
  }
  return chosen;
}

bool have_color(const Faces& colors) { return (colors.array() != kNone).any(); }

bool have_faces_one_color(const Faces& colors) {
  return colors.col(0) == colors.col(1) && colors.col(0) == colors.col(2);
}

// Makes a material for each colour, in order of appearance; returns false if there are too many.
bool use_materials(const MeshView& mesh, std::int32_t num_materials, const Faces& colors,
                   SurfaceColors& result) {
  std::unordered_map<std::int32_t, std::int32_t> material_of_color;
  for (const std::int32_t color : colors.col(0)) {
    const auto next = num_materials + static_cast<std::int32_t>(material_of_color.size());
    if (color == kNone || !material_of_color.try_emplace(color, next).second) continue;
    if (material_of_color.size() > kMaxMaterials) return false;
    result.materials.push_back(material_of(color));
  }
  result.face_material.setConstant(mesh.num_faces(), kNone);
  if (mesh.has_materials()) result.face_material = mesh.face_material;
  for (Eigen::Index f = 0; f < colors.rows(); ++f) {
    if (colors(f, 0) != kNone) result.face_material[f] = material_of_color[colors(f, 0)];
  }
  return true;
}

Colors mean_of_corners(const MeshView& mesh, const Faces& corner_colors) {
  Rows<float, 3> sums = Rows<float, 3>::Zero(mesh.num_vertices(), 3);
  Eigen::VectorXf counts = Eigen::VectorXf::Zero(mesh.num_vertices());
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const std::int32_t rgb = corner_colors(f, c), vertex = mesh.faces(f, c);
      if (rgb == kNone) continue;
      for (int k = 0; k < 3; ++k) sums(vertex, k) += static_cast<float>(channel(rgb, k));
      counts[vertex] += 1.0F;
    }
  }
  Colors colors = Colors::Constant(mesh.num_vertices(), 3, 255);
  for (Eigen::Index v = 0; v < mesh.num_vertices(); ++v) {
    if (counts[v] == 0.0F) continue;
    for (int k = 0; k < 3; ++k) {
      colors(v, k) = static_cast<std::uint8_t>(std::lround(sums(v, k) / counts[v]));
    }
  }
  return colors;
}

/// Whether each corner has the colour of its vertex.
bool are_kept(const MeshView& mesh, const Faces& corner_colors, const Colors& colors) {
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const std::int32_t rgb = corner_colors(f, c);
      const auto own = colors.row(mesh.faces(f, c));
      if (rgb != kNone && rgb != (own[0] << 16 | own[1] << 8 | own[2])) return false;
    }
  }
  return true;
}

}  // namespace

SurfaceColors surface_colors(const MeshView& mesh, std::int32_t num_materials,
                             const CornerColors& corner_colors) {
  if (corner_colors.rows() != mesh.num_faces()) {
    throw InputError("corner_colors: expected " + std::to_string(mesh.num_faces()) +
                     " rows, one for each face, got " + std::to_string(corner_colors.rows()));
  }
  SurfaceColors result;
  Faces on_material = colors_of_faces(mesh, corner_colors, true);
  const Faces alone = colors_of_faces(mesh, corner_colors, false);
  // Many programs write a layer of white that nobody has painted.
  if ((on_material.array() == kNone || on_material.array() == kWhite).all()) {
    on_material.setConstant(kNone);
  }
  const bool has_few =
      have_faces_one_color(alone) && use_materials(mesh, num_materials, alone, result);
  if (!has_few || result.materials.empty()) result = {};
  Faces rest = has_few ? on_material : on_material.cwiseMax(alone);
  if (!have_color(rest)) return result;
  for (Eigen::Index f = 0; has_few && f < alone.rows(); ++f) {
    // The material made for this face has its colour, and those of vertices multiply it.
    if (alone(f, 0) != kNone) rest.row(f).setConstant(kWhite);
  }
  result.colors = mean_of_corners(mesh, rest);
  if (!have_faces_one_color(rest) || are_kept(mesh, rest, result.colors)) return result;
  result.warning = has_few ? "faces with materials have colors, too"
                           : "faces have more than " + std::to_string(kMaxMaterials) + " colors";
  result.warning += ": each vertex takes the mean of its faces";
  return result;
}

std::array<double, 3> linear_color(std::int32_t rgb) {
  return {linear_from_srgb(channel(rgb, 0)), linear_from_srgb(channel(rgb, 1)),
          linear_from_srgb(channel(rgb, 2))};
}

}  // namespace manip3d
