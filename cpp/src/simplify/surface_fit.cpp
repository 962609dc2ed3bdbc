#include "simplify/surface_fit.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/topology.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// After three steps the mean distance falls by less than a hundredth.
constexpr int kSteps = 3;

/// Points that are farther away than this many mean distances belong to something that is gone.
constexpr double kFarAway = 8.0;

/// Number of original faces for each face left, below which each original face gives several
/// points: with half of the faces left, one of each (two to a face) would draw the vertices to
/// where these points are met and the surface between them is not.
constexpr std::int64_t kManyFaces = 30;
constexpr int kMostPoints = 3;

/// There the mean of the distances counts, not that of their squares, for those that exceed this
/// many mean distances; where few faces are left it makes the error larger by 1 to 5 %.
constexpr double kNearMean = 0.5;

/// Shorter vectors (the diagonal is 1) have no direction.
constexpr double kNoDistance = 1e-12;

/// Faces that one thread looks at in one go.
constexpr std::int64_t kChunk = 512;

/// Barycentric coordinates of sample k of a face: its centroid, or the points with which a sum of
/// three is exact for squares.
Vector3d weights_of(int per_face, int k) {
  if (per_face == 1) return Vector3d::Constant(1.0 / 3.0);
  Vector3d weights = Vector3d::Constant(1.0 / 6.0);
  weights[k] = 2.0 / 3.0;
  return weights;
}

/// The weight of a distance whose absolute value counts, as far as it exceeds the least one that
/// can be told; 0: its square counts.
double robust_factor(double distance, double least) {
  return least > 0.0 ? least / (std::abs(distance) + least) : 1.0;
}

}  // namespace

SurfaceFit::SurfaceFit(const MeshView& original, std::function<bool(std::int32_t)> is_there)
    : original_(original), is_there_(std::move(is_there)) {}

void SurfaceFit::run(CollapseMesh& mesh, const Move& move, const Progress& progress) {
  const bool has_many = original_.num_faces() > kManyFaces * mesh.num_faces();
  // Few faces move far, so that points come to lie nearest to others.
  const int searches = has_many ? kSteps : 1;
  for (int i = 0; i < searches; ++i) {
    find_nearest(mesh, has_many ? 1 : kMostPoints,
                 part_of(progress, 1.0 * i / searches, (i + 1.0) / searches));
    const double least = has_many ? 0.0 : kNearMean * mean_distance();
    drop_far_samples();
    for (int k = 0; k < kSteps / searches; ++k) {
      if (progress) progress((i + 1.0) / searches);
      step(mesh, least, move);
    }
  }
}

void SurfaceFit::find_nearest(const CollapseMesh& mesh, int per_face, const Progress& progress) {
  now_.faces.resize(mesh.num_faces(), 3);
  slots_.clear();
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    if (!mesh.is_alive(f)) continue;
    const auto& face = mesh.face(f);
    now_.faces.row(static_cast<Eigen::Index>(slots_.size())) << face[0], face[1], face[2];
    slots_.push_back(f);
  }
  now_.vertices.resize(mesh.num_vertices(), 3);
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    now_.vertices.row(v) = mesh.position(v).transpose();
  }
  const TriangleBvh bvh(now_, part_of(progress, 0.0, 0.3));
  per_face_ = per_face;
  samples_.assign(per_face * original_.num_faces(), {});
  const auto search = [&](std::int64_t begin, std::int64_t end) {
    std::int32_t near_face = 0;
    for (std::int64_t f = begin; f < end; ++f) find_nearest_of(mesh, bvh, f, near_face);
  };
  parallel_chunks(original_.num_faces(), kChunk, 0, search, part_of(progress, 0.3, 1.0));
}

void SurfaceFit::find_nearest_of(const CollapseMesh& mesh, const TriangleBvh& bvh,
                                 std::int64_t face, std::int32_t& near_face) {
  // A vertex that only such faces use belongs to no piece, which is_there_ must not be asked about.
  if (is_degenerate(original_.faces, face) || !is_there_(original_.faces(face, 0))) return;
  Eigen::Matrix3d corners;
  for (int c = 0; c < 3; ++c) {
    corners.col(c) = mesh.from_input(original_.vertices.row(original_.faces(face, c)).transpose());
  }
  const double area =
      (corners.col(1) - corners.col(0)).cross(corners.col(2) - corners.col(0)).norm();
  if (!(area > 0.0)) return;
  for (int k = 0; k < per_face_; ++k) {
    const Vector3d point = corners * weights_of(per_face_, k);
    const SurfacePoint nearest = bvh.closest_point(point, near_face);
    near_face = nearest.face;
    Sample& sample = samples_[static_cast<std::size_t>(per_face_ * face + k)];
    Vector3d direction = point - nearest.point;
    sample.distance = direction.norm();
    if (!(sample.distance > kNoDistance)) {
      const auto corner = [&](int c) -> Vector3d {
        return now_.vertices.row(now_.faces(near_face, c)).transpose();
      };
      direction = (corner(1) - corner(0)).cross(corner(2) - corner(0));
      sample.distance = 0.0;
    }
    const double length = direction.norm();
    if (!(length > 0.0)) continue;
    sample.face = near_face;
    sample.area = static_cast<float>(area / per_face_);
    sample.direction = (direction / length).cast<float>();
    sample.barycentric = nearest.barycentric;
  }
}

double SurfaceFit::mean_distance() const {
  double sum = 0.0, total = 0.0;
  for (const Sample& sample : samples_) {
    sum += sample.area * sample.distance;
    total += sample.area;
  }
  return total > 0.0 ? sum / total : 0.0;
}

void SurfaceFit::drop_far_samples() {
  const double limit = kFarAway * mean_distance();
  for (Sample& sample : samples_) {
    if (sample.distance > limit) sample.face = -1;
  }
}

/// The distances are those along the directions in which the search found them: the nearest points
/// slide along the surface when its vertices move.
void SurfaceFit::step(CollapseMesh& mesh, double least_distance, const Move& move) const {
  std::vector<Vector3d> pull(mesh.num_vertices(), Vector3d::Zero());
  std::vector<double> weight(mesh.num_vertices(), 0.0);
  for (const Sample& sample : samples_) {
    if (sample.face < 0) continue;
    const auto face = now_.faces.row(sample.face);
    Vector3d moved = Vector3d::Zero();
    for (int k = 0; k < 3; ++k) {
      moved +=
          sample.barycentric[k] * (mesh.position(face(k)) - now_.vertices.row(face(k)).transpose());
    }
    const Vector3d direction = sample.direction.cast<double>();
    const double distance = sample.distance - direction.dot(moved);
    const double factor = robust_factor(distance, least_distance);
    for (int k = 0; k < 3; ++k) {
      const double w = factor * sample.area * sample.barycentric[k];
      pull[face(k)] += w * distance * direction;
      weight[face(k)] += w;
    }
  }
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    if (!mesh.is_isolated(v) && weight[v] > 0.0) move(v, pull[v] / weight[v], weight[v]);
  }
}

std::int64_t SurfaceFit::surface_of(std::int64_t sample) const {
  const std::int64_t f = sample / per_face_;
  const std::int64_t material = original_.has_materials() ? original_.face_material(f) : -1;
  return 2 * material + (original_.face_has_texcoords(f) ? 1 : 0);
}

Vector2d SurfaceFit::texture_of(std::int64_t sample) const {
  const std::int64_t f = sample / per_face_;
  const Vector3d weights = weights_of(per_face_, static_cast<int>(sample % per_face_));
  Vector2d result = Vector2d::Zero();
  for (int k = 0; k < 3; ++k) {
    result += weights[k] * original_.texcoords.row(original_.face_texcoords(f, k)).transpose();
  }
  return result;
}

void SurfaceFit::fit_texture(CollapseMesh& mesh,
                             const std::function<bool(std::int32_t)>& may_change,
                             const SetTexture& set, const Progress& progress) const {
  Ticker ticker(progress);
  const auto wedges_of = [&](const Sample& sample) -> const auto& {
    return mesh.wedges(slots_[sample.face]);
  };
  struct Textured {
    std::size_t sample;
    Vector2d texture;
  };
  std::vector<Textured> textured;
  for (std::size_t i = 0; i < samples_.size(); ++i) {
    ticker.tick();
    if (samples_[i].face < 0) continue;
    const std::int32_t wedge = wedges_of(samples_[i])[0];
    const auto index = static_cast<std::int64_t>(i);
    if (!mesh.has_texture(wedge) || surface_of(index) != mesh.surface(wedge)) continue;
    textured.push_back({i, texture_of(index)});
  }
  for (int step = 0; step < kSteps; ++step) {
    const auto residual = [&](const Textured& t) -> Vector2d {
      const Sample& sample = samples_[t.sample];
      const auto& w = wedges_of(sample);
      return t.texture - sample.barycentric[0] * mesh.uv(w[0]) -
             sample.barycentric[1] * mesh.uv(w[1]) - sample.barycentric[2] * mesh.uv(w[2]);
    };
    double sum = 0.0, total = 0.0;
    for (const Textured& t : textured) {
      sum += samples_[t.sample].area * residual(t).norm();
      total += samples_[t.sample].area;
    }
    if (!(total > 0.0)) return;
    const double mean = sum / total;
    const double limit = kFarAway * mean;
    std::vector<Vector2d> pull(mesh.num_wedges(), Vector2d::Zero());
    std::vector<double> weight(mesh.num_wedges(), 0.0);
    for (const Textured& t : textured) {
      const Vector2d r = residual(t);
      if (r.norm() > limit) continue;  // another chart
      const Sample& sample = samples_[t.sample];
      const auto face = now_.faces.row(sample.face);
      const double factor = robust_factor(r.norm(), per_face_ > 1 ? kNearMean * mean : 0.0);
      for (int k = 0; k < 3; ++k) {
        if (!may_change(face(k))) continue;
        const double w = factor * sample.area * sample.barycentric[k];
        const std::int32_t wedge = wedges_of(sample)[k];
        pull[wedge] += w * r;
        weight[wedge] += w;
      }
    }
    for (std::int32_t w = 0; w < mesh.num_wedges(); ++w) {
      if (weight[w] > 0.0) set(w, mesh.uv(w) + pull[w] / weight[w]);
    }
  }
}

}  // namespace manip3d
