#include "manip3d/simplify/collapse_record.hpp"

#include <algorithm>
#include <string>

#include "manip3d/error.hpp"
#include "manip3d/geometry/topology.hpp"

namespace manip3d {

std::vector<std::int64_t> faces_left(
    const MeshView& mesh, const std::vector<std::pair<std::int32_t, std::int32_t>>& collapses,
    const Progress& progress) {
  check_mesh(mesh);
  Faces faces = mesh.faces;
  std::vector<std::vector<std::int32_t>> faces_of(mesh.num_vertices());
  std::int64_t count = 0;
  Ticker ticker(progress);
  for (Eigen::Index f = 0; f < faces.rows(); ++f) {
    ticker.tick();
    if (is_degenerate(faces, f)) continue;
    ++count;
    for (int c = 0; c < 3; ++c) faces_of[faces(f, c)].push_back(static_cast<std::int32_t>(f));
  }
  std::vector<std::int64_t> left;
  left.reserve(collapses.size());
  std::vector<bool> is_left(mesh.num_vertices(), true);
  const auto is_vertex = [&](std::int32_t v) {
    return v >= 0 && v < mesh.num_vertices() && is_left[v];
  };
  for (const auto& [removed, kept] : collapses) {
    ticker.tick();
    if (!is_vertex(removed) || !is_vertex(kept) || removed == kept) {
      throw InputError("collapses: expected two vertices that are left of the mesh, got " +
                       std::to_string(removed) + " -> " + std::to_string(kept));
    }
    std::vector<std::int32_t>& of_kept = faces_of[kept];
    for (const std::int32_t f : faces_of[removed]) {
      if (is_degenerate(faces, f)) continue;
      std::replace(faces.row(f).begin(), faces.row(f).end(), removed, kept);
      is_degenerate(faces, f) ? void(--count) : of_kept.push_back(f);
    }
    faces_of[removed] = {};
    is_left[removed] = false;
    left.push_back(count);
  }
  return left;
}

}  // namespace manip3d
