#include "simplify/distance_guard.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <utility>

#include "manip3d/geometry/exact.hpp"

namespace manip3d {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Bound of the rounding errors of distances in a mesh of diagonal 1, with a margin.
constexpr double kRounding = 1e-13;

/// Oriented edges of faces in one plane; an edge and its reverse cancel.
class Chain {
 public:
  void add(const Vector3d& from, const Vector3d& to) {
    for (auto edge = edges_.begin(); edge != edges_.end(); ++edge) {
      if (edge->first != to || edge->second != from) continue;
      edges_.erase(edge);
      return;
    }
    edges_.emplace_back(from, to);
  }
  /// Whether the edges bound nothing: all cancel, or three remain that form a triangle without
  /// area.
  [[nodiscard]] bool is_zero() const {
    if (edges_.empty()) return true;
    return edges_.size() == 3 && are_collinear(edges_[0].first, edges_[1].first, edges_[2].first);
  }

 private:
  std::vector<std::pair<Vector3d, Vector3d>> edges_;
};

/// Orientation of a triangle seen along an axis; 0 if its projection has no area.
int orientation_along(int axis, const Triangle3& t) {
  const auto seen = [axis](const Vector3d& p) {
    return Vector2d(p[(axis + 1) % 3], p[(axis + 2) % 3]);
  };
  return orientation(seen(t[0]), seen(t[1]), seen(t[2]));
}

int axis_of(const Triangle3& t) {
  for (int axis = 0; axis < 3; ++axis) {
    if (orientation_along(axis, t) != 0) return axis;
  }
  return -1;
}

bool is_in_plane_of(const Triangle3& plane, const Triangle3& t) {
  return std::all_of(t.begin(), t.end(), [&](const Vector3d& p) {
    return are_coplanar(plane[0], plane[1], plane[2], p);
  });
}

}  // namespace

DistanceGuard::DistanceGuard(const MeshView& original, double limit, std::function<void()> on_proof)
    : on_proof_(std::move(on_proof)), is_exact_(limit == 0.0) {
  const BoundingBox box = bounding_box(original);
  if (!is_exact_ && box.diagonal() > 0.0) {
    center_ = box.center();
    unit_ = box.diagonal();
    // Coordinates far from the origin were rounded when the mesh was made, and results are rounded
    // once more.
    const double farthest = std::max(box.min.cwiseAbs().maxCoeff(), box.max.cwiseAbs().maxCoeff());
    margin_ = kRounding + 4.0 * std::numeric_limits<double>::epsilon() * farthest / unit_;
  }
  limit_ = limit / unit_ - margin_;
  const std::size_t count = original.num_faces();
  original_.reserve(count);
  current_.reserve(count);
  for (Eigen::Index f = 0; f < original.num_faces(); ++f) {
    Triangle3 corners;
    for (int k = 0; k < 3; ++k) corners[k] = original.vertices.row(original.faces(f, k));
    original_.push_back(to_unit(corners));
    current_.push_back({original_.back(), 0.0});
  }
  is_touched_.resize(count);
  if (is_exact_) return;
  is_affected_.resize(count);
  bounds_.resize(count);
  guests_.resize(count);
  hosts_.resize(count);
  for (std::size_t f = 0; f < count; ++f) {
    guests_[f] = hosts_[f] = {static_cast<std::int32_t>(f)};
  }
}

Triangle3 DistanceGuard::to_unit(const Triangle3& corners) const {
  Triangle3 result;
  for (int k = 0; k < 3; ++k) result[k] = (corners[k] - center_) / unit_;
  return result;
}

bool DistanceGuard::allows(std::span<const std::int32_t> touched, std::span<const Change> changed,
                           std::span<const std::int32_t> around) {
  touched_.assign(touched.begin(), touched.end());
  changed_.clear();
  for (const Change& change : changed) {
    changed_.push_back({change.face, to_unit(change.corners)});
  }
  if (is_exact_) return keeps_points(touched, changed_);
  if (!(limit_ > 0.0)) return false;
  for (const std::int32_t f : touched) is_touched_[f] = true;
  gather_guests(touched);
  const bool ok = prove_changed(touched, around) && prove_guests(around);
  for (const std::int32_t f : touched) is_touched_[f] = false;
  return ok;
}

/// Whether a change keeps the surface as a set of points. Sufficient: in each plane, the faces
/// before and after have the same orientation and the same boundary. They are then equal as chains,
/// and so are the sets that they cover.
bool DistanceGuard::keeps_points(std::span<const std::int32_t> touched,
                                 std::span<const Change> changed) const {
  struct Plane {
    Triangle3 face;
    int axis;
    int orientation;
    Chain difference;
  };
  std::vector<Plane> planes;
  const auto add = [&](const Triangle3& t, bool is_new) {
    if (!std::all_of(t.begin(), t.end(), is_exact)) return false;
    auto plane = std::find_if(planes.begin(), planes.end(), [&](const Plane& p) {
      return orientation_along(p.axis, t) == p.orientation && is_in_plane_of(p.face, t);
    });
    if (plane == planes.end()) {
      const int axis = axis_of(t);
      if (is_new || axis < 0) return false;
      planes.push_back({t, axis, orientation_along(axis, t), {}});
      plane = planes.end() - 1;
    }
    for (int k = 0; k < 3; ++k) {
      const Vector3d &from = t[k], &to = t[(k + 1) % 3];
      is_new ? plane->difference.add(to, from) : plane->difference.add(from, to);
    }
    return true;
  };
  for (const std::int32_t f : touched) {
    if (!add(current_[f].corners, false)) return false;
  }
  for (const Change& change : changed) {
    if (!add(change.corners, true)) return false;
  }
  return std::all_of(planes.begin(), planes.end(),
                     [](const Plane& plane) { return plane.difference.is_zero(); });
}

/// Gathers the original faces that have a touched face among their hosts.
void DistanceGuard::gather_guests(std::span<const std::int32_t> touched) {
  affected_.clear();
  for (const std::int32_t f : touched) {
    for (const std::int32_t original : guests_[f]) {
      if (is_affected_[original]) continue;
      const auto& hosts = hosts_[original];
      if (std::none_of(hosts.begin(), hosts.end(), [&](auto host) { return is_touched_[host]; })) {
        continue;  // it now has other hosts
      }
      is_affected_[original] = true;
      affected_.push_back(original);
    }
  }
  for (const std::int32_t original : affected_) is_affected_[original] = false;
}

bool DistanceGuard::prove_changed(std::span<const std::int32_t> touched,
                                  std::span<const std::int32_t> around) {
  errors_.clear();
  for (const Change& change : changed_) {
    if (on_proof_) on_proof_();
    patch_.clear();
    for (const std::int32_t f : touched) patch_.push_back(current_[f]);
    double error = distance_.bound(change.corners, patch_, limit_);
    if (error > limit_) {  // the bounds of the replaced faces add up; use the original faces
      patch_.clear();
      for (const std::int32_t original : affected_) patch_.push_back({original_[original], 0.0});
      error = distance_.bound(change.corners, patch_, limit_);
    }
    if (error > limit_) {
      for (const std::int32_t f : around) patch_.push_back(current_[f]);
      error = distance_.bound(change.corners, patch_, limit_);
    }
    if (error > limit_) return false;
    errors_.push_back(error);
  }
  return true;
}

bool DistanceGuard::prove_guests(std::span<const std::int32_t> around) {
  proofs_.clear();
  return std::all_of(affected_.begin(), affected_.end(), [&](std::int32_t original) {
    if (on_proof_) on_proof_();
    return prove_guest(original, {}) || prove_guest(original, around);
  });
}

bool DistanceGuard::prove_guest(std::int32_t original, std::span<const std::int32_t> others) {
  patch_.clear();
  patch_faces_.clear();
  const auto add = [&](std::int32_t face, const Triangle3& corners) {
    patch_.push_back({corners, 0.0});
    patch_faces_.push_back(face);
  };
  for (const Change& change : changed_) add(change.face, change.corners);
  for (const std::int32_t host : hosts_[original]) {
    if (!is_touched_[host]) add(host, current_[host].corners);
  }
  for (const std::int32_t face : others) {
    if (!is_touched_[face]) add(face, current_[face].corners);
  }
  const double bound = distance_.bound(original_[original], patch_, limit_);
  if (bound > limit_) return false;
  Proof& proof = proofs_.emplace_back(Proof{original, bound, {}});
  for (const std::int32_t i : distance_.used()) proof.hosts.push_back(patch_faces_[i]);
  std::sort(proof.hosts.begin(), proof.hosts.end());
  proof.hosts.erase(std::unique(proof.hosts.begin(), proof.hosts.end()), proof.hosts.end());
  return true;
}

void DistanceGuard::commit() {
  is_changed_ = true;
  if (is_exact_) {
    for (const Change& change : changed_) current_[change.face].corners = change.corners;
    return;
  }
  for (const std::int32_t f : touched_) {
    guests_[f].clear();
    current_[f].error = 0.0;
  }
  for (std::size_t i = 0; i < changed_.size(); ++i) {
    current_[changed_[i].face] = {changed_[i].corners, errors_[i]};
  }
  for (Proof& proof : proofs_) {
    std::vector<std::int32_t>& hosts = hosts_[proof.original];
    for (const std::int32_t host : proof.hosts) {
      // Untouched hosts that already were hosts still list the face; lists of touched hosts are
      // new.
      const bool is_listed = std::find(touched_.begin(), touched_.end(), host) == touched_.end() &&
                             std::find(hosts.begin(), hosts.end(), host) != hosts.end();
      if (!is_listed) guests_[host].push_back(proof.original);
    }
    hosts = std::move(proof.hosts);
    bounds_[proof.original] = proof.bound;
  }
}

double DistanceGuard::bound() const {
  if (is_exact_ || !is_changed_) return 0.0;
  double largest = *std::max_element(bounds_.begin(), bounds_.end());
  for (const PatchTriangle& face : current_) largest = std::max(largest, face.error);
  return (largest + margin_) * unit_;
}

}  // namespace manip3d
