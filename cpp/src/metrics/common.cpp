#include "metrics/common.hpp"

#include <new>

#include "manip3d/error.hpp"

namespace manip3d {
namespace {

void normalize(MeshView& view, Vertices& moved, const Eigen::Vector3d& center, double unit) {
  moved = (view.vertices.rowwise() - center.transpose()) / unit;
  using Map = MeshView::Map<Vertices>;
  new (&view.vertices) Map(moved.data(), moved.rows(), 3);  // Eigen's way to rebind a map
}

void check_has_faces(const MeshView& mesh, const char* name) {
  check_mesh(mesh);
  if (mesh.num_faces() > 0) return;
  throw InputError(std::string(name) + ": expected at least one face, got none");
}

}  // namespace

NormalizedPair::NormalizedPair(const MeshView& original, const MeshView& simplified)
    : original_(original), simplified_(simplified) {
  check_has_faces(original, "original");
  check_has_faces(simplified, "simplified");
  const BoundingBox box = bounding_box(original);
  const double half_size = (box.max - box.center()).maxCoeff();
  if (!(half_size > 0.0)) {
    throw InputError("original: expected a bounding box with a diagonal > 0, got a point");
  }
  unit_ = std::ldexp(1.0, std::clamp(std::ilogb(half_size), -1000, 1000));
  diagonal_ = ((box.max - box.center()) / unit_ - (box.min - box.center()) / unit_).norm();
  normalize(original_, original_vertices_, box.center(), unit_);
  normalize(simplified_, simplified_vertices_, box.center(), unit_);
}

}  // namespace manip3d
