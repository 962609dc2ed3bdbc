#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "simplify/fast_mesh.hpp"

namespace manip3d::fast_detail {
namespace {

using Eigen::Vector3d;

/// Size of the arena. Huge pages save much of the time of a small mesh and nothing measurable of a
/// large one; below half a huge page, most of it would be empty.
std::size_t bytes_of_arena(const MeshView& mesh) {
  constexpr std::size_t kBytesOfFace = 128, kLeast = std::size_t{1} << 20;
  constexpr std::size_t kMost = std::size_t{1} << 26;
  const std::size_t bytes = kBytesOfFace * static_cast<std::size_t>(mesh.num_faces());
  return bytes < kLeast || bytes > kMost ? 0 : bytes;
}

/// Up to this many faces are compared pairwise.
constexpr std::size_t kMaxCompared = 8;

std::int32_t lowest(const Triple& f) { return std::min({f[0], f[1], f[2]}); }

/// Whether two of the faces `here`, whose lowest vertex is v, may have the same corners. A quick
/// test, because nearly always none do.
bool may_be_copies(const Bulk<Triple>& faces, std::int32_t v,
                   const std::vector<std::int32_t>& here) {
  if (here.size() > kMaxCompared) return true;
  std::array<std::uint64_t, kMaxCompared> sides;  // NOLINT: filled below
  bool is_any = false;
  for (std::size_t i = 0; i < here.size(); ++i) {
    const Triple& face = faces[here[i]];
    const auto c = static_cast<std::uint32_t>(2 * (face[2] == v) + (face[1] == v));
    const std::int32_t next = face[after(c)], last = face[before(c)];
    sides[i] = static_cast<std::uint64_t>(next) << 32 | static_cast<std::uint32_t>(last);
    for (std::size_t j = 0; j < i; ++j) is_any |= sides[j] == sides[i];
  }
  return is_any;
}

/// Appends the faces of `here` (in order) that have the key of an earlier one.
template <typename Key>
void append_copies(std::vector<std::int32_t>& here, const Key& key,
                   std::vector<std::int32_t>& copies) {
  if (here.size() <= kMaxCompared) {
    for (std::size_t i = 1; i < here.size(); ++i) {
      const auto own = key(here[i]);
      if (std::any_of(here.begin(), here.begin() + static_cast<std::ptrdiff_t>(i),
                      [&](std::int32_t f) { return key(f) == own; })) {
        copies.push_back(here[i]);
      }
    }
    return;
  }
  std::sort(here.begin(), here.end(), [&](std::int32_t f, std::int32_t g) {
    const auto a = key(f), b = key(g);
    return a != b ? a < b : f < g;
  });
  for (std::size_t i = 1; i < here.size(); ++i) {
    if (key(here[i]) == key(here[i - 1])) copies.push_back(here[i]);
  }
}

}  // namespace

FastMesh::FastMesh(const MeshView& mesh, const BoundingBox& box, const std::vector<bool>& locked_in,
                   Tasks& in_tasks)
    : input(mesh),
      tasks(in_tasks),
      scale(box.diagonal() > 0.0 ? box.diagonal() : 1.0),
      center(box.center()),
      arena(bytes_of_arena(mesh)),
      order(spatial_order(mesh, box, in_tasks.num_threads(), arena, in_tasks.part(0.0, 0.05))) {
  load_vertices(locked_in);
  load_faces();
  build_adjacency();
  load_attributes();
}

void FastMesh::load_vertices(const std::vector<bool>& locked_in) {
  vertices.resize(order.source.size());
  into.assign(vertices.size(), -1);
  id.resize(vertices.size());
  is_moved.assign(vertices.size(), 0);
  over_vertices([&](std::int32_t v) {
    const Vector3d p = (input.vertices.row(order.source[v]).transpose() - center) / scale;
    QuadricVertex& vertex = vertices[v];
    vertex = {};
    vertex.x = static_cast<float>(p.x());
    vertex.y = static_cast<float>(p.y());
    vertex.z = static_cast<float>(p.z());
    id[v] = v;
  });
  if (!locked_in.empty()) {
    locked.assign(vertices.size(), 0);
    for (std::size_t v = 0; v < locked_in.size(); ++v) {
      if (locked_in[v] && order.rank[v] >= 0) locked[order.rank[v]] = 1;
    }
  }
  if (input.colors.rows() > 0) colors.resize(vertices.size());
  over_vertices([&](std::int32_t v) {
    if (!colors.empty()) colors[v] = input.colors.row(order.source[v]).cast<float>().transpose();
  });
}

/// Loads the faces in the order of their lowest vertices.
void FastMesh::load_faces() {
  const auto count = static_cast<std::int64_t>(input.num_faces());
  Bulk<Triple> ranks(count, arena);
  tasks.over(count, kBlock, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t f = begin; f < end; ++f) {
      const std::int32_t* face = input.faces.data() + 3 * f;
      ranks[f] = {order.rank[face[0]], order.rank[face[1]], order.rank[face[2]]};
    }
  });
  tasks.report(0.06);
  Bulk<std::int32_t> start(vertices.size() + 1, 0, arena);
  in_ranges([&](const auto& is_mine) {
    for (const Triple& face : ranks) {
      if (is_mine(lowest(face)) && !is_degenerate(face)) ++start[lowest(face) + 1];
    }
  });
  for (std::size_t v = 1; v < start.size(); ++v) start[v] += start[v - 1];
  faces.resize(start.back());
  face_ids.resize(start.back());
  num_dropped += count - start.back();
  in_ranges([&](const auto& is_mine) {
    for (std::int64_t f = 0; f < count; ++f) {
      const Triple& face = ranks[f];
      if (!is_mine(lowest(face)) || is_degenerate(face)) continue;
      const std::int32_t row = start[lowest(face)]++;
      faces[row] = face;
      face_ids[row] = static_cast<std::int32_t>(f);
    }
  });
  tasks.report(0.08);
}

void FastMesh::load_attributes() {
  if (input.has_texcoords() || input.has_materials()) {
    wedges.resize(faces.size());
    table = make_wedges(
        input, num_vertices(),
        [&](std::int32_t v, const auto& body) {
          for (const std::uint32_t corner : corners(v)) {
            const std::uint32_t f = corner / 3;
            body(face_ids[f], static_cast<std::int32_t>(corner - 3 * f), corner);
          }
        },
        [&](std::int64_t corner, std::int32_t wedge) { wedges[corner / 3][corner % 3] = wedge; });
    wedge_into.resize(table.size());
    for (std::int32_t w = 0; w < table.size(); ++w) wedge_into[w] = w;
  }
  if (input.face_normals.rows() > 0) {
    normals.resize(faces.size());
    for (std::size_t f = 0; f < faces.size(); ++f) {
      const auto n = input.face_normals.row(face_ids[f]);
      normals[f] = {n(0), n(1), n(2)};
    }
  }
  remove_equal_faces();
  tasks.report(0.12);
}

/// Removes all but the first of the faces with the same corners and wedges in the same orientation.
void FastMesh::remove_equal_faces() {
  const auto key = [&](std::int32_t f) {
    const Triple& face = faces[f];
    const auto k =
        static_cast<std::uint32_t>(std::min_element(face.begin(), face.end()) - face.begin());
    std::array<std::int32_t, 6> result{face[k], face[after(k)], face[before(k)], 0, 0, 0};
    if (has_wedges()) {
      const Triple& w = wedges[f];
      result[3] = w[k], result[4] = w[after(k)], result[5] = w[before(k)];
    }
    return result;
  };
  const auto count = static_cast<std::int32_t>(faces.size());
  std::vector<std::vector<std::int32_t>> copies(num_blocks());
  over_blocks([&](std::int64_t block, std::int64_t begin, std::int64_t end) {
    std::vector<std::int32_t> here;
    auto f = static_cast<std::int32_t>(begin);
    // Faces with the same lowest vertex belong to the block of the first of them.
    while (f > 0 && f < end && lowest(faces[f]) == lowest(faces[f - 1])) ++f;
    for (std::int32_t next = f; f < end; f = next) {
      here.clear();
      const std::int32_t v = lowest(faces[f]);
      for (; next < count && lowest(faces[next]) == v; ++next) here.push_back(next);
      if (may_be_copies(faces, v, here)) append_copies(here, key, copies[block]);
    }
  });
  std::vector<std::uint8_t> is_copy;
  for (const std::vector<std::int32_t>& of_block : copies) {
    if (!of_block.empty()) is_copy.resize(faces.size(), 0);
    for (const std::int32_t f : of_block) is_copy[f] = 1;
  }
  if (is_copy.empty()) return;
  num_dropped += std::count(is_copy.begin(), is_copy.end(), 1);
  keep_faces([&](std::int32_t f) { return is_copy[f] == 0; });
  build_adjacency();
}

}  // namespace manip3d::fast_detail
