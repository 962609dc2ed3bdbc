#include "simplify/turned_normals.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace manip3d {
namespace {

using Eigen::Vector3d;

// Chosen on eleven models, reported on others (benchmarks/results/meshes.md).
constexpr double kMaxFromMean = 0.9396926207859084;  // cos 20 deg: a normal and its faces' mean
constexpr double kMaxFromFace = 0.5;                 // cos 60 deg: a normal and its face
constexpr double kSmooth = 0.766044443118978;        // cos 40 deg: faces that share a new normal
constexpr std::ptrdiff_t kMaxCorners = 512;  // of a fan, above which each face has its own normal

Vector3d unit_or_zero(const Vector3d& v) {
  const double squared = v.squaredNorm();
  const bool is_exact = squared > 1e-280 && squared < 1e280;  // neither underflow nor overflow
  const double length = is_exact ? std::sqrt(squared) : v.stableNorm();
  return length > 0.0 ? Vector3d(v / length) : Vector3d::Zero();
}

std::array<Vector3d, 3> corners_of(const Eigen::Ref<const Vertices>& vertices,
                                   const Eigen::Ref<const Faces>& faces, Eigen::Index f) {
  std::array<Vector3d, 3> corners;
  for (int c = 0; c < 3; ++c) corners[c] = vertices.row(faces(f, c)).transpose();
  return corners;
}

/// The direction that a face is seen from; zero without an area.
Vector3d direction_of(const std::array<Vector3d, 3>& p) {
  return unit_or_zero(unit_or_zero(p[1] - p[0]).cross(unit_or_zero(p[2] - p[0])));
}

class TurnedNormals {
 public:
  TurnedNormals(const MeshView& input, const std::vector<std::int32_t>& face_map,
                TriangleMesh& mesh)
      : mesh_(mesh), num_given_(mesh.normals.rows()), faces_(mesh.faces.rows()) {
    for (std::size_t f = 0; f < face_map.size(); ++f) {
      if (face_map[f] >= 0) look_at(input, static_cast<Eigen::Index>(f), face_map[f]);
    }
  }

  void mend() {
    const std::vector<std::int32_t> first = first_corners();
    std::vector<std::int32_t> corners(static_cast<std::size_t>(first.back()));
    std::vector<std::int32_t> next(first.begin(), first.end() - 1);
    for (Eigen::Index i = 0; i < mesh_.faces.size(); ++i) {
      if (counts(i)) corners[next[mesh_.faces.data()[i]]++] = static_cast<std::int32_t>(i);
    }
    const auto normal_of = [&](std::int32_t corner) { return mesh_.face_normals.data()[corner]; };
    for (std::size_t v = 0; v + 1 < first.size(); ++v) {
      const auto end = corners.begin() + first[v + 1];
      auto begin = corners.begin() + first[v];
      std::stable_sort(begin, end,
                       [&](std::int32_t a, std::int32_t b) { return normal_of(a) < normal_of(b); });
      while (begin != end) {
        const std::int32_t normal = normal_of(*begin);
        const auto last = std::find_if(
            begin, end, [&](std::int32_t corner) { return normal_of(corner) != normal; });
        group_.assign(begin, last);
        mend_group(unit_or_zero(mesh_.normals.row(normal).transpose()));
        begin = last;
      }
    }
    store();
  }

 private:
  struct Face {
    Vector3d direction = Vector3d::Zero();  // on the side of the normals
    bool counts = false;  // has an area, and had normals near its own where it comes from
    bool is_changed = false;
  };

  [[nodiscard]] bool counts(Eigen::Index corner) const {
    return mesh_.face_normals.data()[corner] >= 0 && faces_[corner / 3].counts;
  }

  /// The corners that count, by vertex: for each vertex, the number of those of earlier vertices.
  [[nodiscard]] std::vector<std::int32_t> first_corners() const {
    std::vector<std::int32_t> first(static_cast<std::size_t>(mesh_.vertices.rows()) + 1, 0);
    for (Eigen::Index i = 0; i < mesh_.faces.size(); ++i) {
      if (counts(i)) ++first[mesh_.faces.data()[i] + 1];
    }
    std::partial_sum(first.begin(), first.end(), first.begin());
    return first;
  }

  /// Fills the face `f` of the mesh, which was `from` in the input.
  void look_at(const MeshView& input, Eigen::Index from, std::int32_t f) {
    const auto before = corners_of(input.vertices, input.faces, from);
    const auto now = corners_of(mesh_.vertices, mesh_.faces, f);
    Face& face = faces_[f];
    face.is_changed = before != now;
    face.direction = direction_of(now);
    const Vector3d direction = direction_of(before);
    std::array<double, 3> cosines = {1.0, 1.0, 1.0};
    for (int c = 0; c < 3; ++c) {
      const std::int32_t normal = input.face_normals(from, c);
      if (normal < 0) continue;
      cosines[c] = direction.dot(unit_or_zero(input.normals.row(normal).transpose()));
    }
    const bool is_inverted = cosines[0] + cosines[1] + cosines[2] < 0.0;
    if (is_inverted) face.direction = -face.direction;
    face.counts = !face.direction.isZero(0.0);
    for (const double cosine : cosines) {
      const bool is_near = (is_inverted ? -cosine : cosine) >= kMaxFromFace;
      if (!is_near && !direction.isZero(0.0)) face.counts = false;
    }
  }

  /// About the angle at a corner (the chord of the unit circle), without libm.
  [[nodiscard]] double weight_of(std::int32_t corner) const {
    const auto p = corners_of(mesh_.vertices, mesh_.faces, corner / 3);
    const int c = corner % 3;
    return (unit_or_zero(p[(c + 1) % 3] - p[c]) - unit_or_zero(p[(c + 2) % 3] - p[c])).norm();
  }

  /// Mends the corners of group_, which share a vertex and this normal.
  void mend_group(const Vector3d& normal) {
    const auto is_changed = [&](std::int32_t corner) { return faces_[corner / 3].is_changed; };
    if (std::none_of(group_.begin(), group_.end(), is_changed)) return;
    const auto is_off_its_face = [&](std::int32_t corner) {
      return normal.dot(faces_[corner / 3].direction) < kMaxFromMean;
    };
    // If the normal is near each face, it is near their mean as well.
    if (std::none_of(group_.begin(), group_.end(), is_off_its_face)) return;
    Vector3d mean = Vector3d::Zero();
    for (const std::int32_t corner : group_) {
      mean += weight_of(corner) * faces_[corner / 3].direction;
    }
    const bool is_off = normal.dot(unit_or_zero(mean)) < kMaxFromMean;
    const Eigen::Index first_row = num_given_ + std::ssize(added_);
    for (const std::int32_t corner : group_) {
      const Vector3d& direction = faces_[corner / 3].direction;
      if (is_off || normal.dot(direction) < kMaxFromFace)
        set(corner, mean_near(direction), first_row);
    }
  }

  /// The mean direction of the faces of group_ that join this one smoothly.
  [[nodiscard]] Vector3d mean_near(const Vector3d& direction) const {
    if (std::ssize(group_) > kMaxCorners) return direction;
    Vector3d mean = Vector3d::Zero();
    for (const std::int32_t corner : group_) {
      const Vector3d& other = faces_[corner / 3].direction;
      if (other.dot(direction) > kSmooth) mean += weight_of(corner) * other;
    }
    return unit_or_zero(mean);
  }

  /// Gives a corner a normal, which those of its group from `first_row` on may have already.
  void set(std::int32_t corner, const Vector3d& normal, Eigen::Index first_row) {
    if (normal.isZero(0.0)) return;
    const auto begin = added_.begin() + (first_row - num_given_);
    auto found = added_.end();
    if (std::ssize(group_) <= kMaxCorners) found = std::find(begin, added_.end(), normal);
    if (found == added_.end()) found = added_.insert(found, normal);
    mesh_.face_normals.data()[corner] =
        static_cast<std::int32_t>(num_given_ + (found - added_.begin()));
  }

  /// Appends the new normals, and leaves out those that no corner has any more.
  void store() {
    if (added_.empty()) return;
    std::vector<std::int32_t> row_of(num_given_ + added_.size(), -1);
    for (Eigen::Index i = 0; i < mesh_.face_normals.size(); ++i) {
      const std::int32_t row = mesh_.face_normals.data()[i];
      if (row >= 0) row_of[row] = 0;
    }
    std::int32_t count = 0;
    for (std::int32_t& row : row_of) row = row < 0 ? -1 : count++;
    Vertices normals(count, 3);
    for (std::size_t i = 0; i < row_of.size(); ++i) {
      if (row_of[i] < 0) continue;
      const auto given = static_cast<Eigen::Index>(i);
      if (given < num_given_) {
        normals.row(row_of[i]) = mesh_.normals.row(given);
      } else {
        normals.row(row_of[i]) = added_[given - num_given_].transpose();
      }
    }
    mesh_.normals = std::move(normals);
    for (Eigen::Index i = 0; i < mesh_.face_normals.size(); ++i) {
      std::int32_t& row = mesh_.face_normals.data()[i];
      if (row >= 0) row = row_of[row];
    }
  }

  TriangleMesh& mesh_;
  Eigen::Index num_given_;
  std::vector<Face> faces_;
  std::vector<std::int32_t> group_;  // corners, 3 * face + corner
  std::vector<Vector3d> added_;
};

}  // namespace

void mend_turned_normals(const MeshView& input, const std::vector<std::int32_t>& face_map,
                         TriangleMesh& mesh) {
  if (mesh.face_normals.rows() > 0) TurnedNormals(input, face_map, mesh).mend();
}

}  // namespace manip3d
