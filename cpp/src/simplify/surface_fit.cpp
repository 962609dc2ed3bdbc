#include "simplify/surface_fit.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <optional>

#include "manip3d/geometry/bvh.hpp"

namespace manip3d {
namespace {

/// After three steps the mean distance falls by less than a hundredth.
constexpr int kSteps = 3;

/// Points that are farther away than this many mean distances belong to something that is gone.
constexpr double kFarAway = 8.0;

/// The faces that are left; vertices keep their numbers.
TriangleMesh current(const CollapseMesh& mesh, std::int32_t num_slots) {
  TriangleMesh now;
  now.faces.resize(mesh.num_faces(), 3);
  Eigen::Index row = 0;
  for (std::int32_t f = 0; f < num_slots; ++f) {
    if (!mesh.is_alive(f)) continue;
    const auto& face = mesh.face(f);
    now.faces.row(row++) << face[0], face[1], face[2];
  }
  now.vertices.resize(mesh.num_vertices(), 3);
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    now.vertices.row(v) = mesh.position(v).transpose();
  }
  return now;
}

/// Barycentric coordinates of a point on a face, each in [0, 1]; none if the face has no area.
std::optional<std::array<double, 3>> barycentric(const TriangleMesh& mesh, std::int32_t f,
                                                 const Eigen::Vector3d& x) {
  const auto face = mesh.faces.row(f);
  const Eigen::Vector3d a = mesh.vertices.row(face(0)), b = mesh.vertices.row(face(1)),
                        c = mesh.vertices.row(face(2));
  const Eigen::Vector3d normal = (b - a).cross(c - a);
  const double squared = normal.squaredNorm();
  if (!(squared > 0.0)) return std::nullopt;
  return std::array{std::clamp((c - b).cross(x - b).dot(normal) / squared, 0.0, 1.0),
                    std::clamp((a - c).cross(x - c).dot(normal) / squared, 0.0, 1.0),
                    std::clamp((b - a).cross(x - a).dot(normal) / squared, 0.0, 1.0)};
}

}  // namespace

SurfaceFit::SurfaceFit(const CollapseMesh& mesh) {
  points_.resize(mesh.num_faces(), 3);
  Eigen::Index row = 0;
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    if (!mesh.is_alive(f)) continue;
    const auto& face = mesh.face(f);
    const Eigen::Vector3d &p = mesh.position(face[0]), &q = mesh.position(face[1]),
                          &r = mesh.position(face[2]);
    points_.row(row++) = ((p + q + r) / 3.0).transpose();
    areas_.push_back((q - p).cross(r - p).norm());
    vertices_.push_back(face[0]);
    const auto& w = mesh.wedges(f);
    surfaces_.push_back(mesh.surface(w[0]));
    texture_.emplace_back((mesh.uv(w[0]) + mesh.uv(w[1]) + mesh.uv(w[2])) / 3.0);
  }
}

void SurfaceFit::run(CollapseMesh& mesh, const std::function<bool(std::int32_t)>& is_there,
                     const std::function<bool(std::int32_t, const Eigen::Vector3d&)>& may_move,
                     const Progress& progress) {
  keep(is_there);
  for (int i = 0; i < kSteps; ++i) {
    step(mesh, may_move, part_of(progress, 1.0 * i / kSteps, (i + 1.0) / kSteps));
  }
}

void SurfaceFit::keep(const std::function<bool(std::int32_t)>& is_there) {
  Eigen::Index row = 0;
  for (Eigen::Index i = 0; i < points_.rows(); ++i) {
    if (!is_there(vertices_[i])) continue;
    points_.row(row) = points_.row(i).eval();
    surfaces_[row] = surfaces_[i];
    texture_[row] = texture_[i];
    areas_[row++] = areas_[i];
  }
  points_.conservativeResize(row, 3);
  areas_.resize(row);
  surfaces_.resize(row);
  texture_.resize(row);
}

void SurfaceFit::fit_texture(CollapseMesh& mesh,
                             const std::function<bool(std::int32_t)>& may_change,
                             const Progress& progress) const {
  const TriangleMesh now = current(mesh, mesh.num_slots());
  std::vector<std::int32_t> slots;  // of a row of now.faces
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    if (mesh.is_alive(f)) slots.push_back(f);
  }
  const ClosestPoints nearest = closest_points(now, points_, 0, progress);
  struct Sample {
    std::size_t index;
    std::int32_t face;
    std::array<double, 3> barycentric;
  };
  std::vector<Sample> samples;
  for (std::size_t i = 0; i < areas_.size(); ++i) {
    const std::int32_t face = slots[nearest.faces[i]];
    const std::int32_t wedge = mesh.wedges(face)[0];
    if (surfaces_[i] != mesh.surface(wedge) || !mesh.has_texture(wedge)) continue;
    const auto row = static_cast<Eigen::Index>(i);
    const auto weights = barycentric(now, nearest.faces[i], nearest.points.row(row).transpose());
    if (weights) samples.push_back({i, face, *weights});
  }
  for (int step = 0; step < kSteps; ++step) {
    const auto residual = [&](const Sample& s) -> Eigen::Vector2d {
      const auto& w = mesh.wedges(s.face);
      return texture_[s.index] - s.barycentric[0] * mesh.uv(w[0]) -
             s.barycentric[1] * mesh.uv(w[1]) - s.barycentric[2] * mesh.uv(w[2]);
    };
    double sum = 0.0, total = 0.0;
    for (const Sample& s : samples) {
      sum += areas_[s.index] * residual(s).norm();
      total += areas_[s.index];
    }
    if (!(total > 0.0)) return;
    const double limit = kFarAway * sum / total;
    std::vector<Eigen::Vector2d> pull(mesh.num_wedges(), Eigen::Vector2d::Zero());
    std::vector<double> weight(mesh.num_wedges(), 0.0);
    for (const Sample& s : samples) {
      const Eigen::Vector2d r = residual(s);
      if (r.norm() > limit) continue;  // another chart
      for (int k = 0; k < 3; ++k) {
        if (!may_change(mesh.face(s.face)[k])) continue;
        const double w = areas_[s.index] * s.barycentric[k];
        const std::int32_t wedge = mesh.wedges(s.face)[k];
        pull[wedge] += w * r;
        weight[wedge] += w;
      }
    }
    for (std::int32_t w = 0; w < mesh.num_wedges(); ++w) {
      if (weight[w] > 0.0) mesh.set_uv(w, mesh.uv(w) + pull[w] / weight[w]);
    }
  }
}

void SurfaceFit::step(CollapseMesh& mesh,
                      const std::function<bool(std::int32_t, const Eigen::Vector3d&)>& may_move,
                      const Progress& progress) const {
  const TriangleMesh now = current(mesh, mesh.num_slots());
  const ClosestPoints nearest = closest_points(now, points_, 0, progress);
  double sum = 0.0, total = 0.0;
  for (std::size_t i = 0; i < areas_.size(); ++i) {
    sum += areas_[i] * nearest.distances[i];
    total += areas_[i];
  }
  if (!(total > 0.0)) return;
  const double limit = kFarAway * sum / total;
  std::vector<Eigen::Vector3d> pull(mesh.num_vertices(), Eigen::Vector3d::Zero());
  std::vector<double> weight(mesh.num_vertices(), 0.0);
  for (std::size_t i = 0; i < areas_.size(); ++i) {
    if (nearest.distances[i] > limit) continue;
    const auto row = static_cast<Eigen::Index>(i);
    const auto face = now.faces.row(nearest.faces[i]);
    const Eigen::Vector3d x = nearest.points.row(row);
    const auto weights = barycentric(now, nearest.faces[i], x);
    if (!weights) continue;
    const Eigen::Vector3d offset = points_.row(row).transpose() - x;
    for (int k = 0; k < 3; ++k) {
      const double w = areas_[i] * (*weights)[k];
      pull[face(k)] += w * offset;
      weight[face(k)] += w;
    }
  }
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    if (mesh.is_isolated(v) || !(weight[v] > 0.0)) continue;
    const Eigen::Vector3d target = mesh.position(v) + pull[v] / weight[v];
    if (may_move(v, target)) mesh.move(v, target);
  }
}

}  // namespace manip3d
