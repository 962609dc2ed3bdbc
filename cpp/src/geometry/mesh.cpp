#include "manip3d/geometry/mesh.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

template <typename Table>
void check_finite(const Table& table, const char* name) {
  for (Eigen::Index row = 0; row < table.rows(); ++row) {
    for (Eigen::Index column = 0; column < table.cols(); ++column) {
      if (std::isfinite(table(row, column))) continue;
      throw InputError(std::string(name) + ": expected finite values, got " +
                       number_text(table(row, column)) + " at row " + std::to_string(row) +
                       ", column " + std::to_string(column));
    }
  }
}

template <typename Table>
void check_indices(const Table& table, std::int64_t lowest, std::int64_t end, const char* name) {
  for (Eigen::Index row = 0; row < table.rows(); ++row) {
    for (Eigen::Index column = 0; column < table.cols(); ++column) {
      const std::int64_t index = table(row, column);
      if (index >= lowest && index < end) continue;
      throw InputError(std::string(name) + ": expected indices in [" + std::to_string(lowest) +
                       ", " + std::to_string(end) + "), got " + std::to_string(index) + " at row " +
                       std::to_string(row));
    }
  }
}

void check_rows(std::int64_t got, std::int64_t expected, const char* name, const char* of) {
  if (got == 0 || got == expected) return;
  throw InputError(std::string(name) + ": expected one row per " + of + " (" +
                   std::to_string(expected) + ") or none, got " + std::to_string(got));
}

}  // namespace

MeshView::MeshView(const TriangleMesh& m)
    : vertices(m.vertices.data(), m.vertices.rows(), 3),
      faces(m.faces.data(), m.faces.rows(), 3),
      texcoords(m.texcoords.data(), m.texcoords.rows(), 2),
      face_texcoords(m.face_texcoords.data(), m.face_texcoords.rows(), 3),
      normals(m.normals.data(), m.normals.rows(), 3),
      face_normals(m.face_normals.data(), m.face_normals.rows(), 3),
      colors(m.colors.data(), m.colors.rows(), 3),
      face_material(m.face_material.data(), m.face_material.rows()) {}

void check_mesh(const MeshView& mesh) {
  constexpr std::int64_t kMax = std::numeric_limits<std::int32_t>::max();
  if (mesh.num_vertices() > kMax || mesh.num_faces() > kMax / 3) {
    throw InputError("mesh: expected at most 2147483647 vertices and 715827882 faces, got " +
                     std::to_string(mesh.num_vertices()) + " and " +
                     std::to_string(mesh.num_faces()));
  }
  const std::int64_t num_faces = mesh.num_faces();
  check_rows(mesh.face_texcoords.rows(), num_faces, "face_texcoords", "face");
  check_rows(mesh.face_normals.rows(), num_faces, "face_normals", "face");
  check_rows(mesh.face_material.rows(), num_faces, "face_material", "face");
  check_rows(mesh.colors.rows(), mesh.num_vertices(), "colors", "vertex");
  check_finite(mesh.vertices, "vertices");
  check_finite(mesh.texcoords, "texcoords");
  check_finite(mesh.normals, "normals");
  check_indices(mesh.faces, 0, mesh.num_vertices(), "faces");
  check_indices(mesh.face_texcoords, -1, mesh.texcoords.rows(), "face_texcoords");
  check_indices(mesh.face_normals, -1, mesh.normals.rows(), "face_normals");
  check_indices(mesh.face_material, -1, kMax, "face_material");
}

BoundingBox bounding_box(const MeshView& mesh) {
  if (mesh.num_faces() == 0) return {};
  BoundingBox box{mesh.vertices.row(mesh.faces(0, 0)), mesh.vertices.row(mesh.faces(0, 0))};
  // One for each corner, so that their updates are independent.
  std::array<BoundingBox, 3> boxes{box, box, box};
  for (Eigen::Index f = 0; f < mesh.faces.rows(); ++f) {
    for (int c = 0; c < 3; ++c) {
      const Eigen::Vector3d p = mesh.vertices.row(mesh.faces(f, c));
      boxes[c].min = boxes[c].min.cwiseMin(p);
      boxes[c].max = boxes[c].max.cwiseMax(p);
    }
  }
  for (const BoundingBox& of_corner : boxes) {
    box.min = box.min.cwiseMin(of_corner.min);
    box.max = box.max.cwiseMax(of_corner.max);
  }
  return box;
}

}  // namespace manip3d
