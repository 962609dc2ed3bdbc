#include "manip3d/io/corner_colors.hpp"

#include <cmath>
#include <cstddef>
#include <unordered_map>

#include "io/colors.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr std::int32_t kNone = -1;

// Limit of colours that become materials. People give parts fewer colours than this; scans have
// thousands.
constexpr std::size_t kMaxMaterials = 256;

using CornerColors = MeshView::Map<Faces>;

bool have_faces_one_color(const CornerColors& colors) {
  return colors.col(0) == colors.col(1) && colors.col(0) == colors.col(2);
}

// Makes a material for each colour, in order of appearance; returns false if there are too many.
bool use_materials(const MeshView& mesh, std::int32_t num_materials, const CornerColors& colors,
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

Colors mean_of_corners(const MeshView& mesh, const CornerColors& corner_colors) {
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

}  // namespace

SurfaceColors surface_colors(const MeshView& mesh, std::int32_t num_materials,
                             const CornerColors& corner_colors) {
  if (corner_colors.rows() != mesh.num_faces()) {
    throw InputError("corner_colors: expected " + std::to_string(mesh.num_faces()) +
                     " rows, one for each face, got " + std::to_string(corner_colors.rows()));
  }
  SurfaceColors result;
  if ((corner_colors.array() == kNone).all()) return result;
  const bool is_flat = have_faces_one_color(corner_colors);
  if (is_flat && use_materials(mesh, num_materials, corner_colors, result)) return result;
  result = {};
  result.colors = mean_of_corners(mesh, corner_colors);
  if (is_flat) {
    result.warning = "faces have more than " + std::to_string(kMaxMaterials) +
                     " colors: each vertex takes the mean of its faces";
  }
  return result;
}

std::array<double, 3> linear_color(std::int32_t rgb) {
  return {linear_from_srgb(channel(rgb, 0)), linear_from_srgb(channel(rgb, 1)),
          linear_from_srgb(channel(rgb, 2))};
}

}  // namespace manip3d
