#include "simplify/collapse_mesh.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "simplify/wedges.hpp"

namespace manip3d {
namespace {

bool has_repeated_vertex(const std::array<std::int32_t, 3>& f) {
  return f[0] == f[1] || f[1] == f[2] || f[2] == f[0];
}

}  // namespace

CollapseMesh::CollapseMesh(const MeshView& mesh)
    : positions_(mesh.num_vertices()),
      moved_(mesh.num_vertices(), false),
      faces_(mesh.num_faces()),
      first_corner_(mesh.num_vertices(), -1),
      next_corner_(3 * mesh.num_faces(), -1),
      previous_corner_(3 * mesh.num_faces(), -1),
      degree_(mesh.num_vertices(), 0) {
  const BoundingBox box = bounding_box(mesh);
  if (box.diagonal() > 0.0) scale_ = box.diagonal();
  center_ = box.center();
  for (std::int32_t v = 0; v < num_vertices(); ++v) {
    positions_[v] = (mesh.vertices.row(v).transpose() - center_) / scale_;
  }
  // From the last corner to the first, so that the lists are in the order of the faces.
  for (auto f = static_cast<std::int32_t>(faces_.size()) - 1; f >= 0; --f) {
    Triple& face = faces_[f];
    face = {mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2)};
    if (has_repeated_vertex(face)) {
      face[0] = -1;
      ++num_dropped_;
      continue;
    }
    ++num_faces_;
    for (int c = 2; c >= 0; --c) {
      const std::int32_t corner = 3 * f + c;
      std::int32_t& first = first_corner_[face[c]];
      next_corner_[corner] = first;
      if (first >= 0) previous_corner_[first] = corner;
      first = corner;
      ++degree_[face[c]];
    }
  }
  make_wedges(mesh);
  if (mesh.face_normals.rows() > 0) {
    normals_ = mesh.normals;
    for (Eigen::Index f = 0; f < mesh.face_normals.rows(); ++f) {
      const auto n = mesh.face_normals.row(f);
      normal_indices_.push_back({n(0), n(1), n(2)});
    }
  }
}

void CollapseMesh::make_wedges(const MeshView& mesh) {
  wedges_ = faces_;
  if (!mesh.has_texcoords() && !mesh.has_materials()) {  // one wedge per vertex
    surface_.assign(positions_.size(), 0);
    texcoords_.assign(positions_.size(), Eigen::Vector2d::Zero());
    texcoord_.assign(positions_.size(), -1);
    return;
  }
  WedgeTable table = manip3d::make_wedges(
      mesh, num_vertices(),
      [&](std::int32_t v, const auto& body) {
        for_each_face(v, [&](std::int32_t f, std::int32_t c) { body(f, c, 3 * f + c); });
      },
      [&](std::int64_t corner, std::int32_t wedge) { wedges_[corner / 3][corner % 3] = wedge; });
  surface_ = std::move(table.surface);
  texcoords_ = std::move(table.texcoords);
  texcoord_ = std::move(table.texcoord);
}

void CollapseMesh::gather_ring(std::int32_t v, Ring& ring) const {
  ring.clear();
  for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    const Triple& face = faces_[f];
    const Triple& wedge = wedges_[f];
    const auto own = c, next = (c + 1) % 3, last = (c + 2) % 3;
    ring.add(face[next], wedge[own], wedge[next]);
    ring.add(face[last], wedge[own], wedge[last]);
  });
}

std::int32_t CollapseMesh::nearest_wedge(std::int32_t wedge, std::int32_t t) const {
  std::int32_t nearest = -1;
  double least = std::numeric_limits<double>::infinity();
  for_each_face(t, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t other = wedges_[f][c];
    if (surface_[other] != surface_[wedge]) return;
    const double distance = (texcoords_[other] - texcoords_[wedge]).squaredNorm();
    if (distance < least || (distance == least && other < nearest)) {
      least = distance;
      nearest = other;
    }
  });
  return nearest;
}

void CollapseMesh::map_wedges(std::int32_t v, std::int32_t t, WedgeMap& map) const {
  map.pairs.clear();
  map.is_complete = true;
  for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    const Triple& face = faces_[f];
    const std::int32_t from = wedges_[f][c];
    for (const std::size_t other : {(c + 1) % 3, (c + 2) % 3}) {
      if (face[other] != t) continue;
      const std::int32_t to = wedges_[f][other];
      const std::int32_t mapped = map.at(from);
      if (mapped < 0) {
        map.pairs.push_back({from, to});
      } else if (mapped != to) {
        map.is_complete = false;  // one wedge at v continues as two at t: a seam ends here
      }
    }
  });
  for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t from = wedges_[f][c];
    if (map.at(from) >= 0) return;
    const std::int32_t nearest = nearest_wedge(from, t);
    if (nearest < 0) map.is_complete = false;
    map.pairs.push_back({from, nearest < 0 ? from : nearest});
  });
}

std::int32_t CollapseMesh::nearest_normal(std::int32_t normal, std::int32_t t) const {
  if (normal < 0) return -1;
  std::int32_t nearest = normal;
  double most = -std::numeric_limits<double>::infinity();
  for_each_face(t, [&](std::int32_t f, std::int32_t c) {
    const std::int32_t other = normal_indices_[f][c];
    if (other < 0) return;
    const double cosine = normals_.row(other).dot(normals_.row(normal));
    if (cosine > most || (cosine == most && other < nearest)) {
      most = cosine;
      nearest = other;
    }
  });
  return nearest;
}

void CollapseMesh::unlink(std::int32_t vertex, std::int32_t corner) {
  const std::int32_t next = next_corner_[corner], last = previous_corner_[corner];
  (last < 0 ? first_corner_[vertex] : next_corner_[last]) = next;
  if (next >= 0) previous_corner_[next] = last;
  --degree_[vertex];
}

void CollapseMesh::remove_face(std::int32_t f) {
  Triple& face = faces_[f];
  for (std::int32_t c = 0; c < 3; ++c) unlink(face[c], 3 * f + c);
  face[0] = -1;
  --num_faces_;
}

void CollapseMesh::collapse(std::int32_t v, std::int32_t t, const WedgeMap& map) {
  if (!normal_indices_.empty()) {  // before t loses faces
    for_each_face(v, [&](std::int32_t f, std::int32_t c) {
      std::int32_t& normal = normal_indices_[f][c];
      normal = nearest_normal(normal, t);
    });
  }
  std::int32_t corner = first_corner_[v];
  first_corner_[v] = -1;
  degree_[v] = 0;
  std::int32_t moved_first = -1;
  std::int32_t moved_last = -1;
  while (corner >= 0) {
    const std::int32_t next = next_corner_[corner];
    const std::int32_t f = corner / 3;
    Triple& face = faces_[f];
    if (face[0] == t || face[1] == t || face[2] == t) {
      for (std::int32_t c = 0; c < 3; ++c) {
        if (face[c] != v) unlink(face[c], 3 * f + c);
      }
      face[0] = -1;
      --num_faces_;
    } else {
      const std::int32_t c = corner - 3 * f;
      face[c] = t;
      wedges_[f][c] = map.at(wedges_[f][c]);
      (moved_last < 0 ? moved_first : next_corner_[moved_last]) = corner;
      previous_corner_[corner] = moved_last;
      moved_last = corner;
      ++degree_[t];
    }
    corner = next;
  }
  if (moved_last < 0) return;
  next_corner_[moved_last] = first_corner_[t];
  if (first_corner_[t] >= 0) previous_corner_[first_corner_[t]] = moved_last;
  first_corner_[t] = moved_first;
}

namespace {

/// Renumbers the used rows of a table: old index -> new index in `renumber` (-1 = unused).
template <typename Table>
Table compact_rows(const Table& table, std::vector<std::int32_t>& renumber) {
  Eigen::Index count = 0;
  for (std::int32_t& i : renumber) i = i < 0 ? -1 : static_cast<std::int32_t>(count++);
  Table result(count, table.cols());
  for (std::size_t i = 0; i < renumber.size(); ++i) {
    if (renumber[i] >= 0) result.row(renumber[i]) = table.row(static_cast<Eigen::Index>(i));
  }
  return result;
}

}  // namespace

TriangleMesh CollapseMesh::extract(const MeshView& input, std::vector<std::int32_t>& kept,
                                   std::vector<std::int32_t>& output_vertex,
                                   std::vector<std::int32_t>& face_map) const {
  TriangleMesh out;
  output_vertex.assign(positions_.size(), -1);
  face_map.assign(faces_.size(), -1);
  std::vector<std::int32_t> texcoord(input.texcoords.rows(), -1);
  std::vector<std::int32_t> normal(input.normals.rows(), -1);
  out.faces.resize(num_faces_, 3);
  if (input.has_texcoords()) out.face_texcoords.resize(num_faces_, 3);
  if (!normal_indices_.empty()) out.face_normals.resize(num_faces_, 3);
  if (input.has_materials()) out.face_material.resize(num_faces_);

  std::int32_t row = 0;
  for (std::int32_t f = 0; f < static_cast<std::int32_t>(faces_.size()); ++f) {
    if (!is_alive(f)) continue;
    face_map[f] = row;
    for (int c = 0; c < 3; ++c) {
      const std::int32_t v = faces_[f][c];
      output_vertex[v] = 0;
      out.faces(row, c) = v;
      if (!normal_indices_.empty()) {
        const std::int32_t n = normal_indices_[f][c];
        if (n >= 0) normal[n] = 0;
        out.face_normals(row, c) = n;
      }
      if (!input.has_texcoords()) continue;
      const std::int32_t t = texcoord_[wedges_[f][c]];
      if (t >= 0) texcoord[t] = 0;
      out.face_texcoords(row, c) = t;
    }
    if (input.has_materials()) out.face_material(row) = input.face_material(f);
    ++row;
  }
  out.vertices = compact_rows<Vertices>(input.vertices, output_vertex);
  if (input.colors.rows() > 0) out.colors = compact_rows<Colors>(input.colors, output_vertex);
  out.texcoords = compact_rows<Texcoords>(input.texcoords, texcoord);
  out.normals = compact_rows<Vertices>(input.normals, normal);
  const auto renumber = [](Faces& table, const std::vector<std::int32_t>& map) {
    for (Eigen::Index i = 0; i < table.size(); ++i) {
      std::int32_t& value = table.data()[i];
      if (value >= 0) value = map[value];
    }
  };
  renumber(out.faces, output_vertex);
  renumber(out.face_texcoords, texcoord);
  renumber(out.face_normals, normal);
  if (out.texcoords.rows() == 0) out.face_texcoords.resize(0, 3);
  kept.clear();
  for (std::int32_t v = 0; v < num_vertices(); ++v) {
    if (output_vertex[v] < 0) continue;
    kept.push_back(v);
    if (moved_[v]) out.vertices.row(output_vertex[v]) = to_input(positions_[v]).transpose();
  }
  if (any_moved_ && out.face_texcoords.rows() > 0) extract_texcoords(out);
  return out;
}

/// One row for each wedge that is in use, in the order of the faces.
void CollapseMesh::extract_texcoords(TriangleMesh& out) const {
  std::vector<std::int32_t> row_of(num_wedges(), -1);
  std::vector<std::int32_t> used;
  std::int32_t row = 0;
  for (std::int32_t f = 0; f < static_cast<std::int32_t>(faces_.size()); ++f) {
    if (!is_alive(f)) continue;
    for (int c = 0; c < 3; ++c) {
      const std::int32_t wedge = wedges_[f][c];
      if (!has_texture(wedge)) continue;
      if (row_of[wedge] < 0) {
        row_of[wedge] = static_cast<std::int32_t>(used.size());
        used.push_back(wedge);
      }
      out.face_texcoords(row, c) = row_of[wedge];
    }
    ++row;
  }
  out.texcoords.resize(static_cast<Eigen::Index>(used.size()), 2);
  for (std::size_t i = 0; i < used.size(); ++i) {
    out.texcoords.row(static_cast<Eigen::Index>(i)) = texcoords_[used[i]];
  }
}

}  // namespace manip3d
