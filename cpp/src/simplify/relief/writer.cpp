#include "simplify/relief/writer.hpp"

#include <algorithm>
#include <cstddef>
#include <utility>

namespace manip3d::relief_detail {

void ReliefWriter::write(const Meshes& meshes, const PointGridView& grid, ReliefResult& result) {
  placed_.clear();
  find_written(meshes);
  const std::span<const Triangulation> levels = meshes.levels;
  result.levels.resize(levels.size());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    ReliefLevel& level = result.levels[levels.size() - 1 - i];
    level.num_vertices = number_vertices(levels[i], written_[i]);
    write_faces(levels[i], grid.rows_up, level.faces);
  }
  number_vertices(meshes.mesh, written_.back());
  write_vertices(meshes.surface, grid, result.mesh);
  write_faces(meshes.mesh, grid.rows_up, result.mesh.faces);
}

void ReliefWriter::find_written(const Meshes& meshes) {
  const auto& [surface, mesh, levels, is_pinhole, once] = meshes;
  written_.resize(levels.size() + 1);
  for (std::vector<Written>& none : written_) none.clear();
  if (!is_pinhole && levels.empty() && !once) return;
  mesh.sorted_vertices(order_, sorting_);
  written_pixels_.clear();
  for (const std::int32_t v : order_) {
    const std::int32_t pixel = mesh.vertex(v).pixel;
    if (!once || written_pixels_.empty() || written_pixels_.back() != pixel) {
      written_pixels_.push_back(pixel);
    }
  }
  find_written_of(mesh, is_pinhole, written_.back());
  for (std::size_t i = levels.size(); i-- > 0;) {
    find_written_of(levels[i], is_pinhole, written_[i]);
  }
}

void ReliefWriter::find_written_of(const Triangulation& mesh,
                                   const std::function<bool(std::int32_t)>& is_pinhole,
                                   std::vector<Written>& how) {
  may_write_.assign(mesh.num_slots(), 0);
  mesh.sorted_vertices(order_, sorting_);
  auto larger = written_pixels_.cbegin();
  const auto find = [&](std::int32_t pixel) {
    while (larger != written_pixels_.cend() && *larger < pixel) ++larger;
    return larger != written_pixels_.cend() && *larger == pixel;
  };
  for (const std::int32_t v : order_) {
    const std::int32_t pixel = mesh.vertex(v).pixel;
    may_write_[v] = find(pixel) && !(is_pinhole && is_pinhole(pixel)) ? 1 : 0;
  }
  how.assign(mesh.num_slots(), Written::kNot);
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!mesh.is_face(t)) continue;
    const Triangle& corners = mesh.triangle(t);
    if (!std::ranges::all_of(corners, [&](std::int32_t v) { return may_write_[v] != 0; })) continue;
    for (const std::int32_t v : corners) how[v] = Written::kWithLast;
  }
  larger = written_pixels_.cbegin();
  std::vector<std::int32_t> own;
  for (const std::int32_t v : order_) {
    const std::int32_t pixel = mesh.vertex(v).pixel;
    if (how[v] == Written::kNot || !find(pixel)) continue;
    how[v] = Written::kAsOwn;
    own.push_back(pixel);
    ++larger;
  }
  written_pixels_.swap(own);
}

std::int32_t ReliefWriter::number_vertices(const Triangulation& mesh,
                                           std::span<const Written> how) {
  mesh.sorted_vertices(order_, sorting_);
  make_room(number_, mesh.num_slots());
  number_.resize(mesh.num_slots());
  const auto num_before = static_cast<std::int32_t>(placed_.size());
  std::int32_t i = 0, latest = Triangulation::kNone;
  for (const std::int32_t v : order_) {
    const std::int32_t pixel = mesh.vertex(v).pixel;
    const Written as = how.empty() ? Written::kAsOwn : how[v];
    if (as == Written::kNot) {
      number_[v] = Triangulation::kNone;
      continue;
    }
    if (as == Written::kWithLast) {
      number_[v] = number_[latest];
    } else if (i < num_before && placed_[i].pixel == pixel) {
      number_[v] = placed_[i++].number;
    } else {
      number_[v] = static_cast<std::int32_t>(placed_.size());
      placed_.push_back({pixel, number_[v]});
    }
    latest = v;
  }
  if (num_before > 0) std::sort(placed_.begin(), placed_.end());
  return static_cast<std::int32_t>(placed_.size());
}

void ReliefWriter::write_vertices(const Surface& surface, const PointGridView& grid,
                                  DepthMesh& out) const {
  const auto width = static_cast<double>(grid.cols), height = static_cast<double>(grid.rows);
  const auto num_vertices = static_cast<Eigen::Index>(placed_.size());
  out.vertices.resize(num_vertices, 3);
  out.pixels.resize(num_vertices, 2);
  out.texcoords.resize(num_vertices, 2);
  for (const auto& [pixel, i] : placed_) {
    const std::int64_t u = surface.input_u(pixel), v = surface.input_v(pixel);
    const float* point = grid.points + 3 * (v * grid.cols + u);
    out.vertices.row(i) << point[0], point[1], point[2];
    out.pixels.row(i) << static_cast<std::int32_t>(u), static_cast<std::int32_t>(v);
    out.texcoords.row(i) << static_cast<float>((static_cast<double>(u) + 0.5) / width),
        static_cast<float>(1.0 - (static_cast<double>(v) + 0.5) / height);
  }
}

void ReliefWriter::write_faces(const Triangulation& mesh, bool rows_up,
                               Rows<std::int32_t, 3>& to) const {
  const auto is_kept = [&](std::int32_t t) {
    return mesh.is_face(t) && std::ranges::none_of(mesh.triangle(t), [this](std::int32_t v) {
             return number_[v] == Triangulation::kNone;
           });
  };
  Eigen::Index num_faces = 0;
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) num_faces += is_kept(t) ? 1 : 0;
  to.resize(num_faces, 3);
  Eigen::Index row = 0;
  for (std::int32_t t = 0; t < mesh.num_face_slots(); ++t) {
    if (!is_kept(t)) continue;
    auto [a, b, c] = mesh.triangle(t);
    if (!rows_up) std::swap(b, c);
    to.row(row++) << number_[a], number_[b], number_[c];
  }
}

}  // namespace manip3d::relief_detail
