#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Converts colours of faces and their corners (0xRRGGBB in sRGB), as files of several formats have
/// them, to colours of materials or vertices.
namespace manip3d {

/// Colours in the form that a mesh has: of materials, or else of vertices. Empty tables mean no
/// change.
struct SurfaceColors {
  /// (F,) indices of materials: those of the mesh, followed by `materials`.
  Indices face_material;
  std::vector<Material> materials;  ///< Materials to append to those of the mesh.
  Colors colors;                    ///< (V, 3); white if no face gives the vertex a colour.
  std::string warning;              ///< Message about lost colours; empty: none was lost.
};

/// Finds the colours of a mesh with `num_materials` materials from the colours of its corners.
///
/// If the faces without a material have one colour each and few colours occur, these become
/// materials, in order of appearance, so that borders between colours stay sharp. Otherwise each
/// vertex gets the mean of the colours of its corners. Faces with a material keep it, and their
/// colours go to vertices, as in glTF; if all of these are white, they are ignored.
/// @param corner_colors  (F, 3), -1: no colour; a face has three colours or none.
/// @throws InputError  the number of rows is not the number of faces.
SurfaceColors surface_colors(const MeshView& mesh, std::int32_t num_materials,
                             const MeshView::Map<Faces>& corner_colors);

/// Red, green and blue of 0xRRGGBB in linear light, as in materials.
std::array<double, 3> linear_color(std::int32_t rgb);

}  // namespace manip3d
