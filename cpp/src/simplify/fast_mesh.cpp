#include "simplify/fast_mesh.hpp"

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "simplify/collapse_rules.hpp"

namespace manip3d::fast_detail {
namespace {

/// Moves the kept rows, which are at the beginning of each chunk, together; empty tables stay
/// empty. Changes `kept` from the number of rows to the new start of each chunk, and returns the
/// number of all rows.
template <typename... Tables>
std::int64_t close_up(std::vector<std::int64_t>& kept, std::int64_t chunk, Tables&... tables) {
  std::int64_t from = 0, to = 0;
  for (std::int64_t& length : kept) {
    const auto close_up_table = [&](auto& rows) {
      if (!rows.empty() && from != to) {
        std::copy_n(rows.begin() + from, length, rows.begin() + to);
      }
    };
    (close_up_table(tables), ...);
    from += chunk;
    to += std::exchange(length, to);
  }
  return to;
}

}  // namespace

bool has_complex_edge(const std::vector<std::int32_t>& ends) {
  for (std::size_t i = 2; i < ends.size(); ++i) {
    if (ends[i] == ends[i - 2]) return true;
  }
  return false;
}

/// Builds lists of corners (3 face + 0..2) by vertex, in the order of the faces.
void FastMesh::build_adjacency() {
  first_corner.assign(vertices.size() + 1, 0);
  corners_by_vertex.resize(3 * faces.size());
  in_ranges([&](const auto& is_mine) {
    for (const Triple& face : faces) {
      for (const std::int32_t v : face) {
        if (is_mine(v)) ++first_corner[v];
      }
    }
  });
  std::uint32_t sum = 0;
  for (std::uint32_t& count : first_corner) count = sum += count;
  // From the last corner to the first: the end of each list moves to its start.
  in_ranges([&](const auto& is_mine) {
    const std::int32_t* vertex = faces.empty() ? nullptr : faces.front().data();
    for (std::size_t i = corners_by_vertex.size(); i-- > 0;) {
      if (is_mine(vertex[i]))
        corners_by_vertex[--first_corner[vertex[i]]] = static_cast<std::uint32_t>(i);
    }
  });
}

/// Finds for each vertex the lowest level at which a single block contains all its faces.
void FastMesh::find_levels() {
  level.resize(vertices.size());
  over_vertices([&](std::int32_t v) {
    level[v] = 0;
    if (first_corner[v] == first_corner[v + 1]) return;
    std::uint32_t low = (corners_by_vertex[first_corner[v]] / 3) >> kBlockBits;
    std::uint32_t high = (corners_by_vertex[first_corner[v + 1] - 1] / 3) >> kBlockBits;
    for (; low != high; low >>= kLevelBits, high >>= kLevelBits) ++level[v];
  });
}

void FastMesh::find_complex_edges() {
  is_complex.resize(vertices.size());
  tasks.over(num_vertices(), kBlock / 2, [&](std::int64_t begin, std::int64_t end) {
    std::vector<std::int32_t> ends;
    for (auto v = static_cast<std::int32_t>(begin); v < end; ++v) {
      ends.clear();
      for_each_face(v, [&](std::uint32_t, std::uint32_t, std::int32_t a, std::int32_t b) {
        ends.push_back(a), ends.push_back(b);
      });
      std::sort(ends.begin(), ends.end());
      is_complex[v] = has_complex_edge(ends) ? 1 : 0;
      is_open[v] |= is_complex[v];
    }
  });
}

void FastMesh::resize_faces(std::size_t count) {
  if (has_wedges()) wedges.resize(count);
  if (!normals.empty()) normals.resize(count);
  faces.resize(count);
  face_ids.resize(count);
}

void FastMesh::begin_pass() {
  remap.resize(vertices.size());
  over_vertices([&](std::int32_t v) { remap[v] = v; });
  is_taken.assign(vertices.size(), 0);
  find_levels();
}

void FastMesh::end_pass() {
  close_up_vertices();
  std::vector<std::int64_t>& kept = kept_of_chunk_;
  kept.assign(num_blocks(), 0);
  over_blocks([&](std::int64_t block, std::int64_t begin, std::int64_t end) {
    std::int64_t to = begin;
    for (std::int64_t f = begin; f < end; ++f) {
      Triple face = faces[f];
      for (std::int32_t& v : face) v = remap[v];
      if (is_degenerate(face)) continue;
      move_face(f, to);
      faces[to] = face;
      if (has_wedges()) {
        for (std::int32_t& w : wedges[to]) w = wedge_into[w];
      }
      ++to;
    }
    kept[block] = to - begin;
  });
  resize_faces(close_up(kept, kBlock, faces, face_ids, wedges, normals));
}

/// Moves the remaining vertices together; afterwards remap has the new index of every vertex.
void FastMesh::close_up_vertices() {
  constexpr std::int64_t kChunk = kBlock / 2;
  std::vector<std::int64_t>& start = kept_of_chunk_;
  start.assign((num_vertices() + kChunk - 1) / kChunk, 0);
  number_.resize(num_vertices());  // within its chunk
  tasks.over(num_vertices(), kChunk, [&](std::int64_t begin, std::int64_t end) {
    std::int64_t to = begin;
    for (std::int64_t v = begin; v < end; ++v) {
      if (remap[v] != v) continue;
      number_[v] = static_cast<std::int32_t>(to - begin);
      vertices[to] = vertices[v];
      id[to] = id[v];
      is_open[to++] = is_open[v];
    }
    start[begin / kChunk] = to - begin;
  });
  const std::int64_t count = close_up(start, kChunk, vertices, id, is_open);
  over_vertices([&](std::int32_t v) {
    const std::int32_t kept = remap[v];
    remap[v] = static_cast<std::int32_t>(start[kept / kChunk]) + number_[kept];
  });
  vertices.resize(count);
  id.resize(count);
  is_open.resize(count);
}

void FastMesh::remove_double_faces(const std::vector<std::int32_t>& around,
                                   std::vector<Triple> twins) {
  std::vector<std::uint8_t> is_around(vertices.size(), 0);
  for (const std::int32_t v : around) is_around[remap[v]] = 1;
  for (Triple& face : twins) {
    for (std::int32_t& v : face) v = remap[v];
    std::sort(face.begin(), face.end());
  }
  std::sort(twins.begin(), twins.end());
  std::vector<std::pair<Triple, std::int32_t>> keys;
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const Triple& face = faces[f];
    if (std::none_of(face.begin(), face.end(), [&](std::int32_t v) { return is_around[v] != 0; })) {
      continue;
    }
    Triple key = face;
    std::sort(key.begin(), key.end());
    if (std::binary_search(twins.begin(), twins.end(), key)) {
      std::rotate_copy(face.begin(), std::min_element(face.begin(), face.end()), face.end(),
                       key.begin());
    }
    keys.emplace_back(key, static_cast<std::int32_t>(f));
  }
  std::sort(keys.begin(), keys.end());
  std::vector<bool> is_double(faces.size(), false);
  for (std::size_t i = 1; i < keys.size(); ++i) {
    if (keys[i].first != keys[i - 1].first) continue;
    is_double[keys[i].second] = true;
    for (const std::int32_t v : keys[i].first) is_open[v] = 1;
  }
  keep_faces([&](std::int32_t f) { return !is_double[f]; });
}

}  // namespace manip3d::fast_detail
