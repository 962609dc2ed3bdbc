#include "geometry/uv_charts.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <utility>

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Groups, scaled to a unit diagonal, lie in planes of this distance.
constexpr double kApart = 2.0;

/// Texture coordinates that differ by less are the same but for rounding.
double rounding(const Vector2d& uv) { return 1e-9 * (1.0 + uv.norm()); }

bool is_point(const Eigen::AlignedBox2d& box) {
  return box.diagonal().norm() <= rounding(box.min());
}

Vector2d texcoord(const MeshView& mesh, std::int32_t face, int corner) {
  return mesh.texcoords.row(mesh.face_texcoords(face, corner)).transpose();
}

/// The group and the texture coordinates of a face, whatever the order of its corners.
std::array<double, 7> shown_by(const MeshView& mesh, std::span<const std::int32_t> group,
                               std::int32_t f) {
  std::array<std::pair<double, double>, 3> corners;
  for (int c = 0; c < 3; ++c) {
    const Vector2d uv = texcoord(mesh, f, c) + Vector2d::Zero();  // turns -0.0 into 0.0
    corners[static_cast<std::size_t>(c)] = {uv.x(), uv.y()};
  }
  std::sort(corners.begin(), corners.end());
  return {static_cast<double>(group[f]),
          corners[0].first,
          corners[0].second,
          corners[1].first,
          corners[1].second,
          corners[2].first,
          corners[2].second};
}

/// The faces that have a group, one of those that show one and the same part. A palette gives many
/// faces one colour, and a query there would visit all of them.
std::vector<std::int32_t> different_faces(const MeshView& mesh,
                                          std::span<const std::int32_t> group) {
  std::vector<std::pair<std::uint64_t, std::int32_t>> faces;  // with a hash of what they show
  faces.reserve(group.size());
  for (std::int32_t f = 0; f < std::ssize(group); ++f) {
    if (group[f] < 0) continue;
    std::uint64_t hash = 0;
    for (const double number : shown_by(mesh, group, f)) {
      hash = (hash ^ std::bit_cast<std::uint64_t>(number)) * 0x9E3779B97F4A7C15U;
      hash ^= hash >> 32U;
    }
    faces.emplace_back(hash, f);
  }
  std::sort(faces.begin(), faces.end());
  const auto shows_the_same = [&](const auto& a, const auto& b) {
    return a.first == b.first && shown_by(mesh, group, a.second) == shown_by(mesh, group, b.second);
  };
  faces.erase(std::unique(faces.begin(), faces.end(), shows_the_same), faces.end());
  std::vector<std::int32_t> different;
  different.reserve(faces.size());
  for (const auto& [hash, f] : faces) different.push_back(f);
  std::sort(different.begin(), different.end());
  return different;
}

}  // namespace

UvCharts::UvCharts(const MeshView& mesh, std::span<const std::int32_t> group,
                   const Progress& progress) {
  const auto num_faces = static_cast<std::int32_t>(group.size());
  for (std::int32_t f = 0; f < num_faces; ++f) {
    if (group[f] < 0) continue;
    if (group[f] >= std::ssize(box_)) box_.resize(static_cast<std::size_t>(group[f]) + 1);
    for (int c = 0; c < 3; ++c) box_[group[f]].extend(texcoord(mesh, f, c));
  }
  const std::vector<std::int32_t> shown = different_faces(mesh, group);
  if (shown.empty()) return;
  TriangleMesh flat;
  flat.faces.resize(std::ssize(shown), 3);
  struct Corner {
    std::int32_t group, row;
  };
  std::vector<Corner> corners;  // by vertex of `flat`
  std::vector<std::int32_t> vertex_of(static_cast<std::size_t>(mesh.texcoords.rows()), -1);
  for (std::size_t i = 0; i < shown.size(); ++i) {
    for (int c = 0; c < 3; ++c) {
      const Corner corner{group[shown[i]], mesh.face_texcoords(shown[i], c)};
      std::int32_t& vertex = vertex_of[corner.row];
      if (vertex < 0 || corners[vertex].group != corner.group) {
        vertex = static_cast<std::int32_t>(corners.size());
        corners.push_back(corner);
      }
      flat.faces(static_cast<Eigen::Index>(i), c) = vertex;
    }
  }
  flat.vertices.resize(std::ssize(corners), 3);
  for (std::size_t v = 0; v < corners.size(); ++v) {
    const Vector2d uv = mesh.texcoords.row(corners[v].row).transpose();
    flat.vertices.row(static_cast<Eigen::Index>(v)) = scaled(corners[v].group, uv).transpose();
  }
  bvh_.emplace(MeshView(flat), progress);
}

std::optional<UvCharts::Nearest> UvCharts::nearest(std::int32_t group, const Vector2d& uv) const {
  if (group < 0 || group >= std::ssize(box_) || box_[group].isEmpty()) return std::nullopt;
  const Vector2d& corner = box_[group].min();
  if (is_point(box_[group])) {
    const bool is_there = (uv - corner).norm() <= rounding(corner);
    return Nearest{corner, is_there ? 0.0 : HUGE_VAL};
  }
  const SurfacePoint found = bvh_->closest_point(scaled(group, uv));
  return Nearest{corner + unit(group) * found.point.head<2>(), found.distance};
}

/// The diagonal of the box of a group, or 1 if it is a point.
double UvCharts::unit(std::int32_t group) const {
  return is_point(box_[group]) ? 1.0 : box_[group].diagonal().norm();
}

Vector3d UvCharts::scaled(std::int32_t group, const Vector2d& uv) const {
  const Vector2d in_unit = (uv - box_[group].min()) / unit(group);
  return {in_unit.x(), in_unit.y(), kApart * group};
}

}  // namespace manip3d
