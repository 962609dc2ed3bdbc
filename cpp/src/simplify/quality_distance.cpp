#include "simplify/quality_distance.hpp"

#include <limits>

namespace manip3d::quality_detail {
namespace {

/// Largest number of edges with failed proofs that are remembered (50 MB); others are tried again.
constexpr std::size_t kMaxRefused = 1 << 20;

void sort_out(std::vector<std::int32_t>& faces) {
  std::sort(faces.begin(), faces.end());
  faces.erase(std::unique(faces.begin(), faces.end()), faces.end());
}

}  // namespace

WithinDistance::WithinDistance(const MeshView& input, const CollapseMesh& mesh, double limit,
                               std::function<void()> on_proof)
    : mesh_(mesh) {
  if (limit < std::numeric_limits<double>::infinity()) {
    guard_.emplace(input, limit, std::move(on_proof));
  }
}

std::optional<double> WithinDistance::bound() const {
  return guard_ ? std::optional(guard_->bound()) : std::nullopt;
}

bool WithinDistance::allows_collapse(std::int32_t v, std::int32_t t, const Vector3d& p) {
  if (!guard_) return true;
  if (refused_.contains({v, t})) return false;
  if (!allows({v, t}, p)) {
    if (refused_.size() < kMaxRefused) refused_.insert({v, t});
    return false;
  }
  refused_.clear();
  return true;
}

bool WithinDistance::allows_move(std::int32_t v, const Vector3d& p) {
  return !guard_ || allows({v}, p);
}

bool WithinDistance::allows(std::initializer_list<std::int32_t> moving, const Vector3d& p) {
  touched_.clear();
  changed_.clear();
  around_.clear();
  const auto moves = [&](std::int32_t v) {
    return std::find(moving.begin(), moving.end(), v) != moving.end();
  };
  for (const std::int32_t v : moving) {
    mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t) { touched_.push_back(f); });
  }
  sort_out(touched_);
  for (const std::int32_t f : touched_) {
    const auto& face = mesh_.face(f);
    DistanceGuard::Change change{f, {}};
    for (int c = 0; c < 3; ++c) {
      change.corners[c] = mesh_.to_input(moves(face[c]) ? p : mesh_.position(face[c]));
      if (moves(face[c])) continue;
      mesh_.for_each_face(face[c], [&](std::int32_t g, std::int32_t) {
        if (!std::binary_search(touched_.begin(), touched_.end(), g)) around_.push_back(g);
      });
    }
    if (std::count_if(face.begin(), face.end(), moves) == 1) changed_.push_back(change);
  }
  sort_out(around_);
  if (!guard_->allows(touched_, changed_, around_)) return false;
  guard_->commit();
  return true;
}

}  // namespace manip3d::quality_detail
