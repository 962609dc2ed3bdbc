#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "io/gltf.hpp"
#include "io/gltf_document.hpp"
#include "manip3d/io/scene_file.hpp"

namespace manip3d {

/// A primitive of triangles, and the rows of its vertices in the table of their mesh.
struct PlacedPrimitive {
  JsonPlace place;
  std::int64_t first_vertex = 0;
  std::int64_t num_vertices = 0;
};

/// Reason why the deformation of a mesh (skin, morph targets) cannot be transferred to other
/// triangles; empty if it can.
std::string reason_not_to_deform(const JsonPlace& primitives, bool has_skin);

/// Reads JOINTS_n and WEIGHTS_n of a single primitive.
/// @throws FormatError  as read_deformation().
Deformation read_influences(GltfDocument& document, const JsonPlace& primitive,
                            std::int64_t num_vertices, GltfBudget& budget);

/// Reads JOINTS_n, WEIGHTS_n and the morph targets of a mesh that reason_not_to_deform() allows.
/// @throws FormatError  an accessor does not fit its attribute or primitive, joints are not
///                      integers, or the budget is exceeded.
Deformation read_deformation(GltfDocument& document, const std::vector<PlacedPrimitive>& primitives,
                             std::int64_t num_vertices, GltfBudget& budget);

}  // namespace manip3d
