#include "simplify/pieces.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/topology.hpp"
#include "simplify/attribute_quadric.hpp"

namespace manip3d {
namespace {

/// Samples per piece: enough for a mean distance, few enough for thousands of pieces.
constexpr std::int64_t kMinSamples = 6, kMaxSamples = 24;

/// Samples of a mesh of one piece. There are more, because they alone decide which of its last
/// faces stay.
constexpr std::int64_t kSamplesOfOne = 96;

/// Distance, as a share of the size of the mesh, that is as wrong as a surface that looks entirely
/// different. Of 0.003, 0.01, 0.03 and 0.1, tried on four models at 10, 3 and 1 % of their faces,
/// larger ones keep more of the materials, and 0.1 costs the fast mode a fifth of the shape.
constexpr double kWrongLook = 0.02;

/// Pairs of opposite rays from each sample that tell how far it can be seen.
constexpr std::int64_t kRays = 2;

/// Distance from a sample at which its rays start, as a share of the size of the mesh: a surface
/// that touches it does not hide it.
constexpr double kStart = 1e-5;

/// A direction of the R3 sequence (Roberts 2018).
Eigen::Vector3d direction_of(std::int64_t number) {
  const Eigen::Array3d steps(0.8191725133961645, 0.6710436067037893, 0.5497004779019703);
  const Eigen::Array3d at = static_cast<double>(number + 1) * steps;
  const Eigen::Vector3d inside = at - at.floor() - 0.5;
  return inside.normalized();
}

/// Position of a sample on its face: the R2 sequence (Roberts 2018), folded into the triangle.
Eigen::Vector3d barycentric_of(std::int64_t sample) {
  constexpr double kStep1 = 0.7548776662466927, kStep2 = 0.5698402909980532;
  const auto number = static_cast<double>(sample + 1);
  double u = number * kStep1 - std::floor(number * kStep1);
  double v = number * kStep2 - std::floor(number * kStep2);
  if (u + v > 1.0) u = 1.0 - u, v = 1.0 - v;
  return {1.0 - u - v, u, v};
}

}  // namespace

Pieces::Pieces(const MeshView& mesh, double scale, const std::vector<std::int32_t>& looks,
               const Progress& progress, bool samples_one)
    : mesh_(mesh), scale_(scale), looks_(looks) {
  Components components = find_components(mesh.faces, mesh.num_vertices());
  of_vertex_ = std::move(components.of_vertex);
  const bool is_one = components.count < 2;
  if (is_one && (!samples_one || components.count == 0)) return;
  pieces_.resize(components.count);
  for (std::int32_t v = 0; v < mesh.num_vertices(); ++v) {
    if (of_vertex_(v) >= 0) pieces_[of_vertex_(v)].vertices.push_back(v);
  }
  for (std::int32_t f = 0; f < mesh.num_faces(); ++f) {
    if (is_degenerate(mesh.faces, f)) continue;
    Piece& piece = pieces_[of_vertex_(mesh.faces(f, 0))];
    piece.area += area_of_face(f);
    ++piece.faces;
  }
  // Samples are taken at equal steps of area, not of faces: a few large faces among many small ones
  // can make up most of a surface.
  std::vector<double> passed(pieces_.size(), 0.0);
  for (std::int32_t f = 0; f < mesh.num_faces(); ++f) {
    if (is_degenerate(mesh.faces, f)) continue;
    const std::int32_t i = of_vertex_(mesh.faces(f, 0));
    Piece& piece = pieces_[i];
    const std::int64_t count =
        is_one ? kSamplesOfOne : std::clamp(piece.faces, kMinSamples, kMaxSamples);
    const double step = piece.area / static_cast<double>(count);
    passed[i] += area_of_face(f);
    for (auto k = static_cast<std::int64_t>(piece.samples.size());
         k < count && !(passed[i] < (static_cast<double>(k) + 0.5) * step); ++k) {
      piece.samples.push_back(f);
    }
  }
  if (is_one) return;
  bvh_ = std::make_unique<TriangleBvh>(mesh, part_of(progress, 0.0, 0.5));
  parallel_chunks(
      size(), 16, 0,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) measure(static_cast<std::int32_t>(i));
      },
      part_of(progress, 0.5, 1.0));
}

Eigen::Vector3d Pieces::point_of(std::int32_t face, std::int64_t sample) const {
  const Eigen::Vector3d weights = barycentric_of(sample);
  Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
  for (int c = 0; c < 3; ++c) sum += weights[c] * mesh_.vertices.row(mesh_.faces(face, c));
  return sum;
}

double Pieces::area_of_face(std::int32_t face) const {
  const Eigen::Vector3d p = mesh_.vertices.row(mesh_.faces(face, 0)) / scale_,
                        q = mesh_.vertices.row(mesh_.faces(face, 1)) / scale_,
                        r = mesh_.vertices.row(mesh_.faces(face, 2)) / scale_;
  return 0.5 * (q - p).cross(r - p).norm();
}

double Pieces::mean_distance(std::int32_t piece) const {
  return pieces_[piece].area > 0.0 ? pieces_[piece].cost / pieces_[piece].area : 0.0;
}

std::vector<Eigen::Vector3d> Pieces::samples(std::int32_t piece) const {
  const std::vector<std::int32_t>& faces = pieces_[piece].samples;
  std::vector<Eigen::Vector3d> points;
  for (std::size_t i = 0; i < faces.size(); ++i) {
    points.push_back(point_of(faces[i], static_cast<std::int64_t>(i)));
  }
  return points;
}

bool Pieces::shows_texture(std::int32_t face) const {
  if (!mesh_.face_has_texcoords(face)) return false;
  double farthest = 0.0;
  for (int c = 0; c < 3; ++c) {
    const auto uv = mesh_.texcoords.row(mesh_.face_texcoords(face, c));
    farthest = std::max(farthest, uv.cwiseAbs().maxCoeff());
  }
  return farthest < kFarthestTexture;
}

std::int32_t Pieces::look_of(std::int32_t face) const {
  const std::int32_t material = mesh_.has_materials() ? mesh_.face_material(face) : -1;
  const bool is_listed = material >= 0 && material < static_cast<std::int64_t>(looks_.size());
  return is_listed ? looks_[material] : material;
}

bool Pieces::shares_texture(std::int32_t face, std::int32_t other) const {
  return shows_texture(face) && shows_texture(other) && look_of(face) == look_of(other);
}

/// Difference between the looks of a point of a face and of another point, apart from the position
/// in a texture that they share: 0 (none) to 1.
double Pieces::difference(std::int32_t face, const Eigen::Vector3d& barycentric,
                          const SurfacePoint& other) const {
  if (look_of(face) != look_of(other.face)) return 1.0;
  if (mesh_.colors.rows() == 0) return 0.0;
  Eigen::RowVector3d between = Eigen::RowVector3d::Zero();
  for (int c = 0; c < 3; ++c) {
    between += barycentric[c] * mesh_.colors.row(mesh_.faces(face, c)).cast<double>();
    between -= other.barycentric[c] * mesh_.colors.row(mesh_.faces(other.face, c)).cast<double>();
  }
  return std::min(1.0, between.norm() / 255.0);
}

/// Share of the directions from which a sample can be seen, on the side where it is seen best. Of
/// two opposite rays, one at least starts into the surface behind the sample.
double Pieces::seen(std::int32_t face, std::int64_t sample) const {
  const Eigen::Vector3d point = point_of(face, sample);
  const auto hides = [&](std::int32_t other) {
    const std::int32_t piece = of_vertex_(mesh_.faces(other, 0));
    return other != face && piece >= 0 && is_there(piece);
  };
  std::int64_t free = 0;
  for (std::int64_t k = 0; k < kRays; ++k) {
    const Eigen::Vector3d ray = direction_of(kRays * sample + k);
    const Eigen::Vector3d start = kStart * scale_ * ray;
    if (!bvh_->is_hit_where(point + start, ray, hides) ||
        !bvh_->is_hit_where(point - start, -ray, hides)) {
      ++free;
    }
  }
  return static_cast<double>(free) / static_cast<double>(kRays);
}

Eigen::RowVector2d Pieces::texture_at(std::int32_t face, const Eigen::Vector3d& barycentric) const {
  Eigen::RowVector2d texture = Eigen::RowVector2d::Zero();
  for (int c = 0; c < 3; ++c) {
    texture += barycentric[c] * mesh_.texcoords.row(mesh_.face_texcoords(face, c));
  }
  return texture;
}

bool Pieces::refresh(std::int32_t piece) {
  const auto& nearest = pieces_[piece].nearest;
  if (std::all_of(nearest.begin(), nearest.end(), [&](std::int32_t p) { return is_there(p); })) {
    return false;
  }
  measure(piece);
  return true;
}

void Pieces::measure(std::int32_t index) {
  Piece& piece = pieces_[index];
  piece.nearest.clear();
  double distances = 0.0, shifts = 0.0, looks = 0.0;
  for (std::size_t i = 0; i < piece.samples.size(); ++i) {
    const std::int32_t own = piece.samples[i];
    const Eigen::Vector3d sample = point_of(own, static_cast<std::int64_t>(i));
    const SurfacePoint point = bvh_->closest_point_where(sample, [&](std::int32_t face) {
      const std::int32_t other = of_vertex_(mesh_.faces(face, 0));
      return other >= 0 && other != index && is_there(other);
    });
    if (point.face < 0) {
      piece.cost = std::numeric_limits<double>::infinity();
      return;
    }
    const double distance = point.distance / scale_;
    distances += distance;
    const Eigen::Vector3d weights = barycentric_of(static_cast<std::int64_t>(i));
    if (shares_texture(own, point.face)) {
      shifts += (texture_at(point.face, point.barycentric) - texture_at(own, weights)).norm();
    }
    const double wrong = kWrongLook * difference(own, weights, point);
    if (wrong > distance) {
      looks += std::max(0.0, wrong * seen(own, static_cast<std::int64_t>(i)) - distance);
    }
    const std::int32_t other = of_vertex_(mesh_.faces(point.face, 0));
    if (std::find(piece.nearest.begin(), piece.nearest.end(), other) == piece.nearest.end()) {
      piece.nearest.push_back(other);
    }
  }
  const auto count = static_cast<double>(std::max<std::size_t>(1, piece.samples.size()));
  piece.cost = piece.area * distances / count;
  piece.texture_shift = shifts / count;
  piece.wrong_look = looks / count;
}

}  // namespace manip3d
