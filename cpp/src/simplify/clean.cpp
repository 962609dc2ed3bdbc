#include "manip3d/simplify/clean.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>
#include <vector>

#include "geometry/buckets.hpp"
#include "manip3d/geometry/compact.hpp"
#include "manip3d/geometry/topology.hpp"
#include "manip3d/geometry/weld.hpp"

namespace manip3d {
namespace {

/// Numbers for the values of a corner of a face; equal numbers stand for equal values.
struct Corner {
  std::int32_t position = -1;
  std::int32_t texcoord = -1;
  std::int32_t color = -1;
  std::int32_t normal = -1;
  auto operator<=>(const Corner&) const = default;
};

/// The corners of a face in an order that is the same for all its duplicates, and its material.
struct FaceKey {
  std::array<Corner, 3> corners;
  std::int32_t material = -1;
  auto operator<=>(const FaceKey&) const = default;

  [[nodiscard]] std::array<std::int32_t, 3> positions() const {
    return {corners[0].position, corners[1].position, corners[2].position};
  }
  /// Whether two faces look alike. Normals are not compared, because the two sides of a surface
  /// always differ in them.
  [[nodiscard]] bool looks_like(const FaceKey& other) const {
    for (std::size_t i = 0; i < 3; ++i) {
      if (corners[i].texcoord != other.corners[i].texcoord) return false;
      if (corners[i].color != other.corners[i].color) return false;
    }
    return material == other.material;
  }
};

void sort_corners(std::array<Corner, 3>& corners, Duplicates duplicates) {
  if (duplicates == Duplicates::kAny) {
    std::sort(corners.begin(), corners.end());
  } else {  // the smallest of the three rotations, which keeps the orientation
    const auto [a, b, c] = corners;
    corners = std::min({std::array{a, b, c}, std::array{b, c, a}, std::array{c, a, b}});
  }
}

std::vector<FaceKey> face_keys(const MeshView& mesh, const Faces& faces, const Faces& positions,
                               Duplicates duplicates, const Progress& progress) {
  const Faces texcoords = weld_indices(mesh.face_texcoords, weld_rows<2>(mesh.texcoords, progress));
  const Faces normals = weld_indices(mesh.face_normals, weld_rows<3>(mesh.normals, progress));
  Ticker ticker(progress);
  const auto packed_color = [&](std::int32_t vertex) {
    const auto rgb = mesh.colors.row(vertex).cast<std::int32_t>();
    return (rgb[0] << 16) | (rgb[1] << 8) | rgb[2];
  };
  std::vector<FaceKey> keys(mesh.num_faces());
  for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
    ticker.tick();
    FaceKey& key = keys[f];
    for (int c = 0; c < 3; ++c) {
      Corner& corner = key.corners[c];
      corner.position = positions(f, c);
      if (texcoords.rows() > 0) corner.texcoord = texcoords(f, c);
      if (normals.rows() > 0) corner.normal = normals(f, c);
      if (mesh.colors.rows() > 0) corner.color = packed_color(faces(f, c));
    }
    sort_corners(key.corners, duplicates);
    if (mesh.has_materials()) key.material = mesh.face_material[f];
  }
  return keys;
}

/// The lowest used vertex at each vertex's position, or -1 if the vertex is in no face.
Indices find_representatives(const Faces& faces, const Weld& positions) {
  Indices representative = Indices::Constant(positions.value.size(), -1);
  for (const std::int32_t v : faces.reshaped()) representative[v] = v;
  Indices lowest = Indices::Constant(positions.num_values(), -1);
  for (std::int32_t v = 0; v < representative.size(); ++v) {
    if (representative[v] < 0) continue;
    std::int32_t& first = lowest[positions.value[v]];
    if (first < 0) first = v;
    representative[v] = first;
  }
  return representative;
}

Indices identity(std::int64_t size) {
  Indices numbers(size);
  std::iota(numbers.begin(), numbers.end(), 0);
  return numbers;
}

std::vector<bool> find_degenerate_faces(const Faces& faces) {
  std::vector<bool> degenerate(faces.rows());
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    degenerate[f] = is_degenerate(faces, f);
  }
  return degenerate;
}

/// Marks all but the first of equal faces in `removed`; counts them, and those that look different.
void remove_duplicates(const MeshView& mesh, const Faces& faces, const Faces& positions,
                       std::int64_t num_positions, Duplicates duplicates, const Progress& progress,
                       std::vector<bool>& removed, CleanResult& result) {
  const std::vector<FaceKey> keys = face_keys(mesh, faces, positions, duplicates, progress);
  Ticker ticker(progress);
  const auto key = [&](std::int32_t f) -> const FaceKey& { return keys[f]; };
  const bool any = duplicates == Duplicates::kAny;
  Buckets<std::int32_t> faces_by_position(num_positions, [&](const auto& put) {
    for (std::int32_t f = 0; f < mesh.num_faces(); ++f) {
      if (!removed[f]) put(key(f).corners[0].position, f);
    }
  });
  const auto compare = [&](std::int32_t a, std::int32_t b) {
    return any ? key(a).positions() <=> key(b).positions() : key(a) <=> key(b);
  };
  for (std::int32_t p = 0; p < faces_by_position.num_keys(); ++p) {
    ticker.tick();
    const auto here = faces_by_position[p];
    std::sort(here.begin(), here.end(), [&](std::int32_t a, std::int32_t b) {
      ticker.tick();
      const auto order = compare(a, b);
      return order < 0 || (order == 0 && a < b);
    });
    std::int32_t kept = -1;
    for (const std::int32_t f : here) {
      if (kept < 0 || compare(kept, f) != 0) {
        kept = f;
        continue;
      }
      removed[f] = true;
      ++result.duplicate_faces;
      result.changed_faces += key(f).looks_like(key(kept)) ? 0 : 1;
    }
  }
}

/// Copies the faces that are not removed, with all their attributes, and fills `face_map`.
void take_faces(const MeshView& mesh, const Faces& faces, const std::vector<bool>& removed,
                CleanResult& result) {
  result.face_map.resize(mesh.num_faces());
  std::vector<std::int32_t> kept;
  for (std::int32_t f = 0; f < mesh.num_faces(); ++f) {
    const bool gone = removed[f];
    result.face_map[f] = gone ? -1 : static_cast<std::int32_t>(kept.size());
    if (!gone) kept.push_back(f);
  }
  TriangleMesh& out = result.mesh;
  out.faces = faces(kept, Eigen::all);
  if (mesh.has_texcoords()) out.face_texcoords = mesh.face_texcoords(kept, Eigen::all);
  if (mesh.face_normals.rows() > 0) out.face_normals = mesh.face_normals(kept, Eigen::all);
  if (mesh.has_materials()) out.face_material = mesh.face_material(kept);
  out.vertices = mesh.vertices;
  out.texcoords = mesh.texcoords;
  out.normals = mesh.normals;
  out.colors = mesh.colors;
}

void map_vertices(const MeshView& mesh, const Indices& representative, CleanResult& result) {
  const Indices compact_map = remove_unreferenced(result.mesh);
  result.vertex_map = Indices::Constant(mesh.num_vertices(), -1);
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    const std::int32_t kept = representative[v];
    if (kept >= 0) result.vertex_map[v] = compact_map[kept];
    if (result.vertex_map[v] < 0) {
      ++result.unreferenced_vertices;
    } else if (kept != v) {
      ++result.merged_vertices;
      const bool recolored = mesh.colors.rows() > 0 && mesh.colors.row(kept) != mesh.colors.row(v);
      result.changed_vertices += recolored ? 1 : 0;
    }
  }
}

}  // namespace

CleanResult clean(const MeshView& mesh, const CleanOptions& options, const Progress& progress) {
  check_mesh(mesh);
  const Weld positions = weld_rows<3>(mesh.vertices, part_of(progress, 0.0, 0.0));
  const Indices representative =
      options.weld ? find_representatives(mesh.faces, positions) : identity(mesh.num_vertices());
  Faces faces = mesh.faces;
  for (std::int32_t& v : faces.reshaped()) v = representative[v];

  CleanResult result;
  std::vector<bool> removed = find_degenerate_faces(faces);
  result.degenerate_faces = std::count(removed.begin(), removed.end(), true);
  if (options.duplicates != Duplicates::kKeep) {
    remove_duplicates(mesh, faces, weld_indices(faces, positions), positions.num_values(),
                      options.duplicates, part_of(progress, 0.3, 0.3), removed, result);
  }
  if (progress) progress(0.8);
  take_faces(mesh, faces, removed, result);
  if (progress) progress(0.9);
  map_vertices(mesh, representative, result);
  return result;
}

}  // namespace manip3d
