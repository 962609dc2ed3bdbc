#pragma once

#include <algorithm>
#include <cstdint>
#include <tuple>
#include <vector>

#include "manip3d/geometry/mesh.hpp"

namespace manip3d {

/// A wedge stands for the attributes of a vertex in some of its faces: faces around a vertex with
/// the same material and the same texture coordinate, or none, share a wedge [Hoppe 1998].
struct WedgeTable {
  std::vector<std::int64_t> surface;  // by wedge: 2 material + (1 if it has texture coordinates)
  std::vector<Eigen::Vector2d> texcoords;
  std::vector<std::int32_t> texcoord;  // row of the input's table, or -1

  [[nodiscard]] std::int32_t size() const { return static_cast<std::int32_t>(surface.size()); }
  [[nodiscard]] bool has_texture(std::int32_t wedge) const { return (surface[wedge] & 1) != 0; }
};

/// Make the wedges of all vertices, in order. for_each_corner(v, body) must call body(face of the
/// input, 0..2, corner) for each corner of v; set_wedge(corner, wedge) receives the result.
template <typename ForEachCorner, typename SetWedge>
WedgeTable make_wedges(const MeshView& mesh, std::int32_t num_vertices,
                       const ForEachCorner& for_each_corner, const SetWedge& set_wedge) {
  struct CornerLook {
    std::int64_t surface;
    double u, v;
    std::int64_t corner;
    std::int32_t texcoord;
    [[nodiscard]] auto key() const { return std::tie(surface, u, v, corner); }
    [[nodiscard]] bool same_wedge(const CornerLook& o) const {
      return surface == o.surface && u == o.u && v == o.v;
    }
  };
  WedgeTable table;
  std::vector<CornerLook> looks;
  for (std::int32_t v = 0; v < num_vertices; ++v) {
    looks.clear();
    for_each_corner(v, [&](std::int32_t f, std::int32_t c, std::int64_t corner) {
      const std::int64_t material = mesh.has_materials() ? mesh.face_material(f) : -1;
      // A face without texture coordinates is a surface of its own, even with the same material.
      const bool textured = mesh.face_has_texcoords(f);
      const std::int32_t t = textured ? mesh.face_texcoords(f, c) : -1;
      looks.push_back({2 * material + (textured ? 1 : 0), textured ? mesh.texcoords(t, 0) : 0.0,
                       textured ? mesh.texcoords(t, 1) : 0.0, corner, t});
    });
    std::sort(looks.begin(), looks.end(),
              [](const CornerLook& a, const CornerLook& b) { return a.key() < b.key(); });
    for (std::size_t i = 0; i < looks.size(); ++i) {
      if (i == 0 || !looks[i].same_wedge(looks[i - 1])) {
        table.surface.push_back(looks[i].surface);
        table.texcoords.emplace_back(looks[i].u, looks[i].v);
        table.texcoord.push_back(looks[i].texcoord);
      }
      set_wedge(looks[i].corner, table.size() - 1);
    }
  }
  return table;
}

}  // namespace manip3d
