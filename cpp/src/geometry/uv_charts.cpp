#include "geometry/uv_charts.hpp"

#include <algorithm>
#include <array>
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

}  // namespace

UvCharts::UvCharts(const MeshView& mesh, std::span<const std::int32_t> group,
                   const Progress& progress) {
  const auto num_faces = static_cast<std::int32_t>(group.size());
  for (std::int32_t f = 0; f < num_faces; ++f) {
    if (group[f] < 0) continue;
    if (group[f] >= std::ssize(box_)) box_.resize(static_cast<std::size_t>(group[f]) + 1);
    for (int c = 0; c < 3; ++c) box_[group[f]].extend(texcoord(mesh, f, c));
  }
  // Many faces may show one and the same part, as where a palette gives each face one colour. A
  // query there would visit all of them.
  using Key = std::array<double, 7>;
  std::vector<Key> shown;
  for (std::int32_t f = 0; f < num_faces; ++f) {
    if (group[f] < 0) continue;
    std::array<std::pair<double, double>, 3> corners;
    for (int c = 0; c < 3; ++c) {
      const Vector2d uv = texcoord(mesh, f, c);
      corners[static_cast<std::size_t>(c)] = {uv.x(), uv.y()};
    }
    std::sort(corners.begin(), corners.end());
    shown.push_back({static_cast<double>(group[f]), corners[0].first, corners[0].second,
                     corners[1].first, corners[1].second, corners[2].first, corners[2].second});
  }
  std::sort(shown.begin(), shown.end());
  shown.erase(std::unique(shown.begin(), shown.end()), shown.end());
  if (shown.empty()) return;
  TriangleMesh flat;
  const auto count = static_cast<Eigen::Index>(shown.size());
  flat.vertices.resize(3 * count, 3);
  flat.faces.resize(count, 3);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Key& key = shown[static_cast<std::size_t>(i)];
    for (int c = 0; c < 3; ++c) {
      const auto at = static_cast<std::size_t>(1 + 2 * c);
      const Vector2d uv(key[at], key[at + 1]);
      flat.vertices.row(3 * i + c) = scaled(static_cast<std::int32_t>(key[0]), uv).transpose();
      flat.faces(i, c) = static_cast<std::int32_t>(3 * i + c);
    }
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
