#include "manip3d/geometry/summary.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "geometry/buckets.hpp"
#include "manip3d/geometry/topology.hpp"
#include "manip3d/geometry/weld.hpp"

namespace manip3d {
namespace {

TopologyCounts count_topology(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices) {
  TopologyCounts counts;
  const Edges edges = find_edges(faces, num_vertices);
  counts.edges = edges.size();
  for (Eigen::Index e = 0; e < edges.size(); ++e) {
    counts.boundary_edges += edges.is_boundary(e) ? 1 : 0;
    counts.non_manifold_edges += edges.is_non_manifold(e) ? 1 : 0;
  }
  const Indices boundary_neighbors = count_boundary_neighbors(edges, num_vertices);
  counts.complex_vertices = std::count_if(boundary_neighbors.begin(), boundary_neighbors.end(),
                                          [](std::int32_t n) { return n != 0 && n != 2; });
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    counts.degenerate_faces += is_degenerate(faces, f) ? 1 : 0;
  }
  counts.duplicate_faces = count_duplicate_faces(faces, num_vertices);
  counts.components = find_components(faces, num_vertices).count;
  return counts;
}

/// Whether the face's area, computed at the scale of its longest side, is zero.
bool has_zero_area(const MeshView& mesh, Eigen::Index face) {
  const Eigen::RowVector3d p0 = mesh.vertices.row(mesh.faces(face, 0));
  Eigen::RowVector3d a = mesh.vertices.row(mesh.faces(face, 1)) - p0;
  Eigen::RowVector3d b = mesh.vertices.row(mesh.faces(face, 2)) - p0;
  const double size = std::max(a.cwiseAbs().maxCoeff(), b.cwiseAbs().maxCoeff());
  if (!(size > 0.0)) return true;
  // Scaling by a power of two causes no rounding and prevents underflow for tiny faces.
  const auto rescale = [exponent = -std::ilogb(size)](double x) {
    return std::scalbn(x, exponent);
  };
  a = a.unaryExpr(rescale).eval();
  b = b.unaryExpr(rescale).eval();
  return !(a.cross(b).squaredNorm() > 0.0);
}

std::int64_t count_zero_area_faces(const MeshView& mesh) {
  std::int64_t count = 0;
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    count += !is_degenerate(mesh.faces, f) && has_zero_area(mesh, f) ? 1 : 0;
  }
  return count;
}

std::int64_t count_referenced(const Eigen::Ref<const Faces>& faces, std::int64_t num_vertices) {
  std::vector<bool> referenced(num_vertices);
  for (const std::int32_t v : faces.reshaped()) referenced[v] = true;
  return std::count(referenced.begin(), referenced.end(), true);
}

std::int64_t count_materials(const MeshView& mesh) {
  std::vector<std::int32_t> used(mesh.face_material.begin(), mesh.face_material.end());
  std::sort(used.begin(), used.end());
  const auto end = std::unique(used.begin(), used.end());
  return end - std::lower_bound(used.begin(), end, 0);
}

std::int64_t count_faces_without_texcoords(const MeshView& mesh) {
  std::int64_t count = 0;
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) count += mesh.face_has_texcoords(f) ? 0 : 1;
  return count;
}

std::int64_t count_multi_uv_vertices(const MeshView& mesh, const Faces& welded_faces,
                                     std::int64_t num_welded) {
  if (!mesh.has_texcoords()) return 0;
  const Faces uv = weld_indices(mesh.face_texcoords, weld_rows<2>(mesh.texcoords));
  Buckets<std::int32_t> uvs_of_vertex(num_welded, [&](const auto& put) {
    for (Eigen::Index f = 0; f < uv.rows(); ++f) {
      for (int c = 0; c < 3; ++c) {
        if (uv(f, c) >= 0) put(welded_faces(f, c), uv(f, c));
      }
    }
  });
  std::int64_t count = 0;
  for (std::int32_t v = 0; v < uvs_of_vertex.num_keys(); ++v) {
    const auto uvs = uvs_of_vertex[v];
    const auto differs = [&](std::int32_t other) { return other != uvs.front(); };
    count += std::any_of(uvs.begin(), uvs.end(), differs) ? 1 : 0;
  }
  return count;
}

}  // namespace

MeshSummary summarize(const MeshView& mesh) {
  check_mesh(mesh);
  const Weld positions = weld_rows<3>(mesh.vertices);
  const Faces welded_faces = weld_indices(mesh.faces, positions);
  const std::int64_t num_welded = positions.num_values();

  MeshSummary summary;
  summary.stored = count_topology(mesh.faces, mesh.num_vertices());
  summary.stored.vertices = mesh.num_vertices();
  summary.welded = count_topology(welded_faces, num_welded);
  summary.welded.vertices = count_referenced(welded_faces, num_welded);
  summary.faces = mesh.num_faces();
  summary.texcoords = mesh.texcoords.rows();
  summary.unreferenced_vertices =
      mesh.num_vertices() - count_referenced(mesh.faces, mesh.num_vertices());
  summary.zero_area_faces = count_zero_area_faces(mesh);
  summary.materials_used = count_materials(mesh);
  summary.faces_without_texcoords = count_faces_without_texcoords(mesh);
  summary.multi_uv_vertices = count_multi_uv_vertices(mesh, welded_faces, num_welded);
  summary.closed = summary.welded.edges > 0 && summary.welded.boundary_edges == 0;
  summary.has_normals = mesh.face_normals.rows() > 0;
  summary.has_colors = mesh.colors.rows() > 0;
  summary.bounding_box = bounding_box(mesh);
  return summary;
}

}  // namespace manip3d
