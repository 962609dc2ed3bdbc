#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

/// @file
/// Colours of faces and their corners, 0xRRGGBB in sRGB, in meshes that have none of their own:
/// what files of several formats hold.
namespace manip3d {

/// Colours as a mesh has them: of materials, or else of vertices. Empty tables stay as they are.
struct SurfaceColors {
  Indices face_material;            ///< (F,), with the materials below after those of the mesh.
  std::vector<Material> materials;  ///< To be added to those of the mesh.
  Colors colors;                    ///< (V, 3); white where no face has a colour.
  std::string warning;              ///< Losses; empty: none.
};

/// Finds colours for a mesh of `num_materials` materials from those of its corners.
///
/// Few colours of whole faces become materials, in order of appearance, which keep their borders;
/// others become colours of vertices, the mean of the corners there.
/// @param corner_colors  (F, 3), -1 where there is none; a face has three or none.
/// @throws InputError  not one row for each face.
SurfaceColors surface_colors(const MeshView& mesh, std::int32_t num_materials,
                             const MeshView::Map<Faces>& corner_colors);

/// Red, green and blue of 0xRRGGBB in linear light, as materials hold them.
std::array<double, 3> linear_color(std::int32_t rgb);

}  // namespace manip3d
