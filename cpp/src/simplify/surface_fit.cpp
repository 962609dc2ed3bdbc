#include "simplify/surface_fit.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "manip3d/geometry/bvh.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/patch_distance.hpp"
#include "manip3d/geometry/topology.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// After three steps, the mean distance decreases by less than a hundredth per step.
constexpr int kSteps = 3;

/// Each step removes a quarter of the linear part of the error of texture coordinates.
constexpr int kTextureSteps = 8;

/// Samples farther away than this many mean distances belong to parts that were removed.
constexpr double kFarAway = 8.0;

/// Number of original faces per remaining face, below which each original face has several samples.
/// With half of the faces left, one sample per face (two per remaining face) would pull the
/// vertices to positions where these samples are met, but the surface between them is not.
constexpr std::int64_t kManyFaces = 30;
constexpr int kMaxPoints = 3;
constexpr int kCentroid = kMaxPoints;  // number of a sample that is the only one of its face

/// In that case, distances above this many mean distances count linearly instead of squared. With
/// few remaining faces this would increase the error by 1 to 5 %.
constexpr double kNearMean = 0.5;

/// Shorter vectors (the diagonal is 1) have no direction.
constexpr double kNoDistance = 1e-12;

/// If the distances of faces to a sample differ by no more than this (the diagonal is 1), the
/// sample may belong to either of them.
constexpr double kSameSheet = 1e-4;

/// Relative margin of a search distance, so that rounding does not exclude the nearest face.
constexpr double kRoundingShare = 1e-12;

/// Samples per chunk of a thread.
constexpr std::int64_t kChunk = 512;

/// A face of the original that is larger than this share of the mean remaining face always has
/// several samples, because the few samples on one remaining face would not determine its tilt.
constexpr double kLargeFace = 0.1;

/// Barycentric coordinates of sample k of a face: the three points with which quadrature is exact
/// for quadratic functions, or the centroid.
Vector3d weights_of(int k) {
  if (k == kCentroid) return Vector3d::Constant(1.0 / 3.0);
  Vector3d weights = Vector3d::Constant(1.0 / 6.0);
  weights[k] = 2.0 / 3.0;
  return weights;
}

/// Weight of a squared distance so that distances above `least` count linearly; 1 if `least` is 0.
double robust_factor(double distance, double least) {
  return least > 0.0 ? least / (std::abs(distance) + least) : 1.0;
}

/// The texture coordinate at a point of a face with these wedges.
Vector2d texture_at(const CollapseMesh& mesh, const CollapseMesh::Triple& wedges,
                    const Vector3d& barycentric) {
  return barycentric[0] * mesh.uv(wedges[0]) + barycentric[1] * mesh.uv(wedges[1]) +
         barycentric[2] * mesh.uv(wedges[2]);
}

}  // namespace

SurfaceFit::SurfaceFit(const MeshView& original, std::function<bool(std::int32_t)> is_there)
    : original_(original), is_there_(std::move(is_there)) {}

void SurfaceFit::run(CollapseMesh& mesh, const Move& move, const Progress& progress) {
  const bool has_many = original_.num_faces() > kManyFaces * mesh.num_faces();
  place_samples(mesh, has_many);
  // With many original faces per remaining one, vertices move far, so that the nearest faces of
  // samples change.
  const int searches = has_many ? kSteps : 1;
  for (int i = 0; i < searches; ++i) {
    find_nearest(mesh, part_of(progress, 1.0 * i / searches, (i + 1.0) / searches));
    least_distance_ = has_many ? 0.0 : kNearMean * mean_distance();
    drop_far_samples();
    for (int k = 0; k < kSteps / searches; ++k) {
      if (progress) progress((i + 1.0) / searches);
      step(mesh, move);
    }
  }
}

void SurfaceFit::place_samples(const CollapseMesh& mesh, bool has_many) {
  double total = 0.0;
  std::vector<double> areas(static_cast<std::size_t>(original_.num_faces()), 0.0);
  for (std::int64_t f = 0; f < original_.num_faces(); ++f) {
    // A vertex used only by degenerate faces belongs to no piece; is_there_ must not be called with
    // it.
    if (is_degenerate(original_.faces, f) || !is_there_(original_.faces(f, 0))) continue;
    // Samples among very many needles are near the boxes of most of them, which makes searches
    // slow, and their error is tiny.
    const auto face = original_.faces.row(f);
    if (mesh.is_hub(face[0]) || mesh.is_hub(face[1]) || mesh.is_hub(face[2])) continue;
    const Eigen::Matrix3d p = corners_of(mesh, f);
    areas[f] = (p.col(1) - p.col(0)).cross(p.col(2) - p.col(0)).norm();
    total += areas[f];
  }
  const double large =
      kLargeFace * total / static_cast<double>(std::max<std::int64_t>(1, mesh.num_faces()));
  const auto has_one = [&](double area) { return has_many && area < large; };
  std::size_t count = 0;
  for (const double area : areas) {
    if (area > 0.0) count += has_one(area) ? 1 : kMaxPoints;
  }
  samples_.clear();
  samples_.reserve(count);
  for (std::int64_t f = 0; f < original_.num_faces(); ++f) {
    if (!(areas[f] > 0.0)) continue;
    const bool one = has_one(areas[f]);
    for (int k = one ? kCentroid : 0; k < (one ? kCentroid + 1 : kMaxPoints); ++k) {
      Sample& sample = samples_.emplace_back();
      sample.source = 4 * static_cast<std::uint32_t>(f) + static_cast<std::uint32_t>(k);
      sample.area = static_cast<float>(one ? areas[f] : areas[f] / kMaxPoints);
    }
  }
}

Eigen::Matrix3d SurfaceFit::corners_of(const CollapseMesh& mesh, std::int64_t face) const {
  Eigen::Matrix3d corners;
  for (int c = 0; c < 3; ++c) {
    corners.col(c) = mesh.from_input(original_.vertices.row(original_.faces(face, c)).transpose());
  }
  return corners;
}

Vector3d SurfaceFit::point_of(const CollapseMesh& mesh, const Sample& sample) const {
  return corners_of(mesh, sample.source / 4) * weights_of(static_cast<int>(sample.source % 4));
}

Vector2d SurfaceFit::texture_of(const Sample& sample) const {
  const std::int64_t f = sample.source / 4;
  const Vector3d weights = weights_of(static_cast<int>(sample.source % 4));
  Vector2d result = Vector2d::Zero();
  for (int k = 0; k < 3; ++k) {
    result += weights[k] * original_.texcoords.row(original_.face_texcoords(f, k)).transpose();
  }
  return result;
}

void SurfaceFit::take_positions(const CollapseMesh& mesh) {
  now_.vertices.resize(mesh.num_vertices(), 3);
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    now_.vertices.row(v) = mesh.position(v).transpose();
  }
}

void SurfaceFit::find_nearest(const CollapseMesh& mesh, const Progress& progress) {
  now_.faces.resize(mesh.num_faces(), 3);
  slots_.clear();
  for (std::int32_t f = 0; f < mesh.num_slots(); ++f) {
    if (!mesh.is_alive(f)) continue;
    const auto& face = mesh.face(f);
    now_.faces.row(static_cast<Eigen::Index>(slots_.size())) << face[0], face[1], face[2];
    slots_.push_back(f);
  }
  take_positions(mesh);
  const TriangleBvh bvh(now_, part_of(progress, 0.0, 0.3));
  const auto search = [&](std::int64_t begin, std::int64_t end) {
    std::int32_t near_face = 0;
    for (std::int64_t i = begin; i < end; ++i) {
      find_nearest_to(mesh, bvh, samples_[static_cast<std::size_t>(i)], near_face);
    }
  };
  parallel_chunks(static_cast<std::int64_t>(samples_.size()), kChunk, 0, search,
                  part_of(progress, 0.3, 1.0));
}

void SurfaceFit::find_nearest_to(const CollapseMesh& mesh, const TriangleBvh& bvh, Sample& sample,
                                 std::int32_t& near_face) const {
  const Vector3d point = point_of(mesh, sample);
  const SurfacePoint nearest = bvh.closest_point(point, near_face);
  near_face = nearest.face;
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
  sample.face = length > 0.0 ? near_face : -1;
  if (!(length > 0.0)) return;
  sample.direction = (direction / length).cast<float>();
  sample.barycentric = nearest.barycentric;
}

double SurfaceFit::mean_distance() const {
  double sum = 0.0, total = 0.0;
  for (const Sample& sample : samples_) {
    if (sample.face < 0) continue;
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

/// Distances are measured along the directions found by the search, because the nearest points
/// slide along the surface when its vertices move.
void SurfaceFit::step(CollapseMesh& mesh, const Move& move) const {
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
    const double factor = robust_factor(distance, least_distance_);
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

/// Finds the face of each sample. The nearest face may belong to another sheet on top of the
/// sample's own, or to another part of a folded chart; among near faces, the one with the nearest
/// texture coordinate is taken.
void SurfaceFit::find_textured(const CollapseMesh& mesh, const std::vector<std::int32_t>& chart,
                               const Progress& progress) {
  take_positions(mesh);
  const TriangleBvh bvh(now_, part_of(progress, 0.0, 0.3));
  const auto triangle = [&](std::int32_t face) {
    Triangle3 corners;
    for (int c = 0; c < 3; ++c) corners[c] = now_.vertices.row(now_.faces(face, c)).transpose();
    return corners;
  };
  const auto search = [&](std::int64_t begin, std::int64_t end) {
    std::vector<SurfacePoint> met;
    for (std::int64_t i = begin; i < end; ++i) {
      Sample& sample = samples_[static_cast<std::size_t>(i)];
      if (sample.face < 0) continue;
      const std::int32_t known = sample.face;
      sample.face = -1;
      const std::int32_t wedge = mesh.wedges(static_cast<std::int32_t>(sample.source / 4))[0];
      if (!mesh.has_texture(wedge)) continue;
      const Vector3d point = point_of(mesh, sample);
      const Vector2d texture = texture_of(sample);
      const auto reach = [](double nearest) {
        return nearest * (1.0 + kRoundingShare) + kSameSheet;
      };
      bvh.faces_within(point, reach(distance(point, triangle(known))), met);
      double nearest = std::numeric_limits<double>::infinity();
      for (const SurfacePoint& candidate : met) nearest = std::min(nearest, candidate.distance);
      double least = std::numeric_limits<double>::infinity();
      for (const SurfacePoint& candidate : met) {
        const auto& wedges = mesh.wedges(slots_[candidate.face]);
        if (candidate.distance > reach(nearest) || chart[wedges[0]] != chart[wedge]) continue;
        const double off =
            (texture - texture_at(mesh, wedges, candidate.barycentric)).squaredNorm();
        if (!(off < least)) continue;
        least = off;
        sample.face = candidate.face;
        sample.barycentric = candidate.barycentric;
      }
    }
  };
  parallel_chunks(static_cast<std::int64_t>(samples_.size()), kChunk, 0, search,
                  part_of(progress, 0.3, 1.0));
}

void SurfaceFit::fit_texture(CollapseMesh& mesh, const std::vector<std::int32_t>& chart,
                             const std::function<bool(std::int32_t)>& may_change,
                             const SetTexture& set, const Progress& progress) {
  find_textured(mesh, chart, part_of(progress, 0.0, 0.7));
  std::erase_if(samples_, [](const Sample& sample) { return sample.face < 0; });
  std::vector<Vector2d> residuals(samples_.size());  // by sample, in the current step
  const auto wedges_of = [&](const Sample& sample) -> const auto& {
    return mesh.wedges(slots_[sample.face]);
  };
  for (int step = 0; step < kTextureSteps; ++step) {
    if (progress) progress(0.7 + 0.3 * step / kTextureSteps);
    double sum = 0.0, total = 0.0;
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      const Sample& sample = samples_[i];
      residuals[i] = texture_of(sample) - texture_at(mesh, wedges_of(sample), sample.barycentric);
      sum += sample.area * residuals[i].norm();
      total += sample.area;
    }
    if (!(total > 0.0)) return;
    const double mean = sum / total;
    const double limit = kFarAway * mean;
    std::vector<Vector2d> pull(mesh.num_wedges(), Vector2d::Zero());
    std::vector<double> weight(mesh.num_wedges(), 0.0);
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      const Vector2d& r = residuals[i];
      if (r.norm() > limit) continue;  // a part of the chart that was removed
      const Sample& sample = samples_[i];
      const auto face = now_.faces.row(sample.face);
      const double factor = robust_factor(r.norm(), least_distance_ > 0.0 ? kNearMean * mean : 0.0);
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
