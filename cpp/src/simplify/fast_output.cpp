#include <cstdint>
#include <vector>

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {

void FastMesh::write(QualityResult& result) const {
  TriangleMesh& out = result.mesh;
  // Vertices used by some face, in order.
  std::vector<std::int32_t> row_of(vertices.size(), -1);
  for (const Triple& face : faces) {
    for (const std::int32_t v : face) row_of[v] = 0;
  }
  std::int32_t num_rows = 0;
  for (std::int32_t& row : row_of) row = row < 0 ? -1 : num_rows++;
  out.vertices.resize(num_rows, 3);
  if (!colors.empty()) out.colors.resize(num_rows, 3);
  std::vector<std::int32_t> output(into.size(), -1);  // of the initial vertices
  for (std::int32_t v = 0; v < num_vertices(); ++v) {
    const std::int32_t row = row_of[v];
    if (row < 0) continue;
    const std::int32_t number = id[v];
    output[number] = row;
    if (is_moved[number] != 0) {
      out.vertices.row(row) =
          (center + scale * position_of(vertices[v]).cast<double>()).transpose();
    } else {
      out.vertices.row(row) = input.vertices.row(order.source[number]);
    }
    if (!colors.empty()) {
      out.colors.row(row) =
          (colors[number].array() + 0.5F).floor().cast<std::uint8_t>().transpose();
    }
  }
  // A vertex collapses into one with a lower index, which is final already.
  for (std::size_t number = 0; number < into.size(); ++number) {
    if (into[number] >= 0) output[number] = output[into[number]];
  }
  result.vertex_map.resize(input.num_vertices());
  tasks.over(input.num_vertices(), kBlock, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t v = begin; v < end; ++v) {
      result.vertex_map[v] = order.rank[v] < 0 ? -1 : output[order.rank[v]];
    }
  });
  const auto count = static_cast<Eigen::Index>(faces.size());
  result.face_map.assign(input.num_faces(), -1);
  out.faces.resize(count, 3);
  if (input.has_materials()) out.face_material.resize(count);
  for (Eigen::Index f = 0; f < count; ++f) {
    const Triple& face = faces[f];
    out.faces.row(f) << row_of[face[0]], row_of[face[1]], row_of[face[2]];
    const std::int32_t row = face_ids[f];
    result.face_map[row] = static_cast<std::int32_t>(f);
    if (input.has_materials()) out.face_material(f) = input.face_material(row);
  }
  if (input.has_texcoords()) write_texcoords(out);
  if (!normals.empty()) write_normals(out);
}

/// Writes one row for each wedge that is in use, in the order of the faces.
void FastMesh::write_texcoords(TriangleMesh& out) const {
  std::vector<std::int32_t> row_of(table.size(), -1);
  std::vector<std::int32_t> used;
  out.face_texcoords.resize(out.faces.rows(), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const std::int32_t wedge = wedges[f][c];
      std::int32_t& row = row_of[wedge];
      if (row < 0 && table.has_texture(wedge)) {
        row = static_cast<std::int32_t>(used.size());
        used.push_back(wedge);
      }
      out.face_texcoords(static_cast<Eigen::Index>(f), c) = row;
    }
  }
  if (used.empty()) out.face_texcoords.resize(0, 3);
  out.texcoords.resize(static_cast<Eigen::Index>(used.size()), 2);
  for (std::size_t i = 0; i < used.size(); ++i) {
    out.texcoords.row(static_cast<Eigen::Index>(i)) = table.texcoords[used[i]];
  }
}

void FastMesh::write_normals(TriangleMesh& out) const {
  std::vector<std::int32_t> row_of(input.normals.rows(), -1);
  std::vector<std::int32_t> used;
  out.face_normals.resize(out.faces.rows(), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const std::int32_t normal = normals[f][c];
      if (normal >= 0 && row_of[normal] < 0) {
        row_of[normal] = static_cast<std::int32_t>(used.size());
        used.push_back(normal);
      }
      out.face_normals(static_cast<Eigen::Index>(f), c) = normal < 0 ? -1 : row_of[normal];
    }
  }
  out.normals = input.normals(used, Eigen::all);
}

}  // namespace manip3d::fast_detail
