#include "manip3d/geometry/compact.hpp"

namespace manip3d {
namespace {

/// (num_rows,) old row -> new row, or -1 for rows that are not in `indices`.
Indices compact_numbering(const Faces& indices, Eigen::Index num_rows) {
  Indices map = Indices::Constant(num_rows, -1);
  for (const std::int32_t row : indices.reshaped()) {
    if (row >= 0) map[row] = 0;
  }
  std::int32_t next = 0;
  for (std::int32_t& row : map) {
    if (row == 0) row = next++;
  }
  return map;
}

void renumber(Faces& indices, const Indices& map) {
  for (std::int32_t& row : indices.reshaped()) {
    if (row >= 0) row = map[row];
  }
}

template <typename Table>
void take_mapped_rows(Table& table, const Indices& map) {
  Eigen::Index size = 0;
  for (Eigen::Index row = 0; row < table.rows(); ++row) {
    if (map[row] >= 0) table.row(size++) = table.row(row);  // a new row is never after its old one
  }
  table.conservativeResize(size, table.cols());
}

template <typename Table>
Indices compact(Faces& indices, Table& table) {
  const Indices map = compact_numbering(indices, table.rows());
  renumber(indices, map);
  take_mapped_rows(table, map);
  return map;
}

}  // namespace

Indices remove_unreferenced(TriangleMesh& mesh) {
  compact(mesh.face_texcoords, mesh.texcoords);
  compact(mesh.face_normals, mesh.normals);
  const Indices vertex_map = compact(mesh.faces, mesh.vertices);
  if (mesh.colors.rows() > 0) take_mapped_rows(mesh.colors, vertex_map);
  return vertex_map;
}

}  // namespace manip3d
