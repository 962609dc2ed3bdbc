#include "manip3d/geometry/shading.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <span>
#include <utility>
#include <vector>

#include "manip3d/error.hpp"
#include "manip3d/geometry/parallel.hpp"
#include "manip3d/geometry/topology.hpp"
#include "manip3d/geometry/weld.hpp"

namespace manip3d {
namespace {

constexpr std::size_t kMaxPairedCorners = 512;  // with more, a hub of n faces would take n^2 time
constexpr std::int64_t kChunk = 4096;

/// Corners (3 face + corner) around each position, in increasing order.
struct CornerFans {
  std::vector<std::int32_t> offsets;
  std::vector<std::int32_t> corners;

  [[nodiscard]] std::span<const std::int32_t> of(std::int64_t position) const {
    const std::size_t p = position;
    return std::span(corners).subspan(offsets[p], offsets[p + 1] - offsets[p]);
  }
};

CornerFans collect_fans(const MeshView& mesh, const Weld& weld) {
  const std::size_t num_positions = weld.num_values();
  CornerFans fans{std::vector<std::int32_t>(num_positions + 1, 0),
                  std::vector<std::int32_t>(mesh.faces.size())};
  const auto position = [&](Eigen::Index corner) {
    return static_cast<std::size_t>(weld.value(mesh.faces(corner / 3, corner % 3)));
  };
  for (Eigen::Index c = 0; c < mesh.faces.size(); ++c) ++fans.offsets[position(c) + 1];
  for (std::size_t p = 0; p < num_positions; ++p) fans.offsets[p + 1] += fans.offsets[p];
  std::vector<std::int32_t> next(fans.offsets.begin(), fans.offsets.end() - 1);
  for (Eigen::Index c = 0; c < mesh.faces.size(); ++c) {
    fans.corners[next[position(c)]++] = static_cast<std::int32_t>(c);
  }
  return fans;
}

/// Unit length, or zero if the length is zero or NaN.
Eigen::Vector3d unit_or_zero(const Eigen::Vector3d& v) {
  const double length = v.stableNorm();
  return length > 0.0 ? Eigen::Vector3d(v / length) : Eigen::Vector3d::Zero();
}

Eigen::Vector3d unit_normal(const MeshView& mesh, Eigen::Index face) {
  const Eigen::Vector3d a = mesh.vertices.row(mesh.faces(face, 0));
  // Normalized edges, because the cross product of tiny or huge ones would underflow or overflow.
  const Eigen::Vector3d u = unit_or_zero(mesh.vertices.row(mesh.faces(face, 1)).transpose() - a);
  const Eigen::Vector3d v = unit_or_zero(mesh.vertices.row(mesh.faces(face, 2)).transpose() - a);
  return unit_or_zero(u.cross(v));
}

double corner_angle(const MeshView& mesh, Eigen::Index corner) {
  const Eigen::Index face = corner / 3;
  const Eigen::Vector3d at = mesh.vertices.row(mesh.faces(face, corner % 3));
  const auto edge_to = [&](Eigen::Index other) {
    return unit_or_zero(mesh.vertices.row(mesh.faces(face, other % 3)).transpose() - at);
  };
  const Eigen::Vector3d u = edge_to(corner % 3 + 1);
  const Eigen::Vector3d v = edge_to(corner % 3 + 2);
  return std::atan2(u.cross(v).norm(), u.dot(v));
}

/// By corner: the mesh's own normal, or zero.
Vertices given_normals(const MeshView& mesh) {
  Vertices given = Vertices::Zero(mesh.faces.size(), 3);
  for (Eigen::Index c = 0; c < mesh.face_normals.size(); ++c) {
    const std::int32_t row = mesh.face_normals(c / 3, c % 3);
    if (row >= 0) given.row(c) = unit_or_zero(mesh.normals.row(row));
  }
  return given;
}

class CreaseShader {
 public:
  CreaseShader(const MeshView& mesh, const CornerFans& fans, double crease_angle_deg)
      : fans_(fans),
        // Slightly larger than the angle, so that 0 still joins coplanar faces.
        min_cosine_(std::cos(crease_angle_deg * EIGEN_PI / 180.0) - 1e-9),
        face_normals_(mesh.num_faces(), 3),
        weighted_(mesh.faces.size(), 3) {
    for (Eigen::Index f = 0; f < mesh.num_faces(); ++f) {
      face_normals_.row(f) = unit_normal(mesh, f);
    }
    for (Eigen::Index c = 0; c < mesh.faces.size(); ++c) {
      weighted_.row(c) = corner_angle(mesh, c) * face_normals_.row(c / 3);
    }
  }

  /// Fills the zero rows of `normals`, for all corners at one position.
  void shade(std::int64_t position, Vertices& normals) const {
    const auto fan = fans_.of(position);
    const bool all = fan.size() > kMaxPairedCorners;
    Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
    if (all) {
      for (const std::int32_t c : fan) sum += weighted_.row(c);
    }
    for (const std::int32_t corner : fan) {
      const auto own = face_normals_.row(corner / 3);
      if (normals.row(corner).isZero(0.0)) {
        normals.row(corner) = all ? sum : smooth_sum(fan, own);
        normals.row(corner) = unit_or_zero(normals.row(corner));
      }
      if (normals.row(corner).isZero(0.0)) normals.row(corner) = own;
      // No face has an area.
      if (normals.row(corner).isZero(0.0)) normals.row(corner) << 0.0, 0.0, 1.0;
      if (normals.row(corner).dot(own) < 0.0) normals.row(corner) *= -1.0;
    }
  }

 private:
  Eigen::RowVector3d smooth_sum(std::span<const std::int32_t> fan,
                                const Eigen::Ref<const Eigen::RowVector3d>& own) const {
    Eigen::RowVector3d sum = Eigen::RowVector3d::Zero();
    const bool flat = own.isZero(0.0);  // a face without area takes the mean of its neighbours
    for (const std::int32_t c : fan) {
      if (flat || face_normals_.row(c / 3).dot(own) >= min_cosine_) sum += weighted_.row(c);
    }
    return sum;
  }

  const CornerFans& fans_;
  double min_cosine_;
  Vertices face_normals_;
  Vertices weighted_;
};

}  // namespace

ShadingNormals shading_normals(const MeshView& mesh, double crease_angle_deg, int num_threads) {
  if (!(crease_angle_deg >= 0.0 && crease_angle_deg <= 180.0)) {
    throw InputError("crease_angle: expected degrees in [0, 180], got " +
                     number_text(crease_angle_deg));
  }
  check_mesh(mesh);
  const CornerFans fans = collect_fans(mesh, weld_rows<3>(mesh.vertices));
  const CreaseShader shader(mesh, fans, crease_angle_deg);
  Vertices normals = given_normals(mesh);
  parallel_chunks(static_cast<std::int64_t>(fans.offsets.size()) - 1, kChunk, num_threads,
                  [&](std::int64_t begin, std::int64_t end) {
                    for (std::int64_t p = begin; p < end; ++p) shader.shade(p, normals);
                  });
  const Weld values = weld_rows<3>(normals);
  ShadingNormals result{Vertices(values.num_values(), 3), Faces(mesh.num_faces(), 3)};
  for (Eigen::Index k = 0; k < values.num_values(); ++k) {
    result.normals.row(k) = normals.row(values.first_row(k));
  }
  for (Eigen::Index c = 0; c < mesh.faces.size(); ++c) {
    result.face_normals(c / 3, c % 3) = values.value(c);
  }
  return result;
}

Rows<std::int32_t, 2> welded_boundary(const MeshView& mesh) {
  check_mesh(mesh);
  const Weld weld = weld_rows<3>(mesh.vertices);
  const Edges edges = find_edges(weld_indices(mesh.faces, weld), weld.num_values());
  std::vector<Eigen::Index> boundary;
  for (Eigen::Index e = 0; e < edges.size(); ++e) {
    if (edges.is_boundary(e)) boundary.push_back(e);
  }
  Rows<std::int32_t, 2> result(static_cast<Eigen::Index>(boundary.size()), 2);
  for (Eigen::Index row = 0; row < result.rows(); ++row) {
    const Eigen::Index e = boundary[row];
    result.row(row) << weld.first_row(edges.vertices(e, 0)), weld.first_row(edges.vertices(e, 1));
  }
  return result;
}

}  // namespace manip3d
