#include "simplify/quality_rules.hpp"

#include "simplify/legality.hpp"

namespace manip3d::quality_detail {

const RingEdge* CollapseCheck::look_at(std::int32_t v, std::int32_t t) {
  v_ = v;
  t_ = t;
  mesh_.gather_ring(v, ring_v_);
  mesh_.gather_ring(t, ring_t_);
  return ring_v_.find(t);
}

/// Whether v or t has an edge of three or more faces.
bool CollapseCheck::has_complex_edge() const {
  const auto has_one = [](const Ring& ring) {
    return std::any_of(ring.edges().begin(), ring.edges().end(),
                       [](const RingEdge& edge) { return is_complex_edge(edge.num_faces); });
  };
  return has_one(ring_v_) || has_one(ring_t_);
}

bool CollapseCheck::breaks_link() const {
  if (may_make_complex_edge(rules_, has_complex_edge())) return false;
  return std::any_of(ring_v_.edges().begin(), ring_v_.edges().end(), [&](const RingEdge& edge) {
    const RingEdge* other = ring_t_.find(edge.vertex);
    return other != nullptr &&
           makes_complex_edge(edge.num_faces, other->num_faces, count_faces(v_, edge.vertex, t_));
  });
}

bool CollapseCheck::takes_last_face_of_locked() const {
  if (!kept_.any_locked()) return false;
  const auto num_faces = [&](std::int32_t of) {
    std::int32_t faces = 0;
    mesh_.for_each_face(of, [&](std::int32_t, std::int32_t) { ++faces; });
    return faces;
  };
  if (kept_.is_locked(v_) || kept_.is_locked(t_)) {
    const std::int32_t on_edge = ring_v_.find(t_)->num_faces;
    if (num_faces(v_) + num_faces(t_) == 2 * on_edge) return true;
  }
  return std::any_of(ring_v_.edges().begin(), ring_v_.edges().end(), [&](const RingEdge& edge) {
    const std::int32_t w = edge.vertex;
    return w != t_ && kept_.is_locked(w) && num_faces(w) == count_faces(w, v_, t_);
  });
}

/// Number of faces of w with the vertices a and b.
std::int32_t CollapseCheck::count_faces(std::int32_t w, std::int32_t a, std::int32_t b) const {
  std::int32_t faces = 0;
  mesh_.for_each_face(w, [&](std::int32_t f, std::int32_t) {
    faces += touches(mesh_, f, a) && touches(mesh_, f, b) ? 1 : 0;
  });
  return faces;
}

std::optional<Rejection> CollapseCheck::check_faces(const Vector3d& p, Rules rules) const {
  std::optional<Rejection> refusal;
  const auto check = [&](std::int32_t from, std::int32_t other) {
    mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
      const std::int32_t a = mesh_.face(f)[(c + 1) % 3], b = mesh_.face(f)[(c + 2) % 3];
      if (refusal || a == other || b == other) return;  // faces on the edge are removed
      refusal = check_face(from, a, b, p, rules);
      const bool meets = from == v_ && ring_t_.find(a) != nullptr && ring_t_.find(b) != nullptr;
      const bool is_forbidden = meets && !may_double(rules);
      if (!refusal && is_forbidden && count_faces(t_, a, b) > 0) refusal = Rejection::kDuplicate;
    });
  };
  check(v_, t_);
  check(t_, v_);
  return refusal;
}

std::optional<Rejection> CollapseCheck::check_move(std::int32_t v, const Vector3d& p) const {
  std::optional<Rejection> refusal;
  mesh_.for_each_face(v, [&](std::int32_t f, std::int32_t c) {
    const auto& face = mesh_.face(f);
    if (!refusal) refusal = check_face(v, face[(c + 1) % 3], face[(c + 2) % 3], p, rules_);
  });
  return refusal;
}

/// Checks the face (from, a, b) with its first vertex moved to p. A face without area, as around
/// the pole of a sphere whose vertices differ there by rounding, can neither lose it nor flip;
/// refusing it would block everything around it.
std::optional<Rejection> CollapseCheck::check_face(std::int32_t from, std::int32_t a,
                                                   std::int32_t b, const Vector3d& p,
                                                   Rules rules) const {
  const Vector3d &pa = mesh_.position(a), &pb = mesh_.position(b), &old = mesh_.position(from);
  const Vector3d before = (pa - old).cross(pb - old), after = (pa - p).cross(pb - p);
  const auto has_area = [&](const Vector3d& normal, const Vector3d& first) {
    const double longest =
        std::max({(pa - first).squaredNorm(), (pb - first).squaredNorm(), (pb - pa).squaredNorm()});
    return normal.norm() > kMinSine * longest;
  };
  const bool had_area = has_area(before, old);
  if (!has_area(after, p)) {
    return had_area ? std::optional(Rejection::kDegenerate) : std::nullopt;
  }
  if (may_turn_faces(rules) || !had_area) return std::nullopt;
  if (!(before.dot(after) > kMinNormalCosine * before.norm() * after.norm())) {
    return Rejection::kFlip;
  }
  return std::nullopt;
}

void CollapseCheck::neighbours(std::vector<std::int32_t>& out) const {
  out.clear();
  for (const Ring* ring : {&ring_v_, &ring_t_}) {
    for (const RingEdge& edge : ring->edges()) out.push_back(edge.vertex);
  }
}

void DoubledFaces::find_twins(std::int32_t v, std::int32_t t) {
  twins_.clear();
  for (const std::int32_t from : {v, t}) {
    sides_.clear();
    mesh_.for_each_face(from, [&](std::int32_t f, std::int32_t c) {
      sides_.push_back({mesh_.face(f)[(c + 1) % 3], mesh_.face(f)[(c + 2) % 3]});
    });
    append_twins(sides_, twins_);
  }
  std::sort(twins_.begin(), twins_.end());
}

void DoubledFaces::remove(std::int32_t t) {
  keys_.clear();
  mesh_.for_each_face(t, [&](std::int32_t f, std::int32_t c) {
    const Side side{mesh_.face(f)[(c + 1) % 3], mesh_.face(f)[(c + 2) % 3]};
    keys_.emplace_back(double_key(side, twins_), f);
  });
  std::stable_sort(keys_.begin(), keys_.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  doubled_.clear();
  for (std::size_t i = 1; i < keys_.size(); ++i) {
    if (keys_[i].first == keys_[i - 1].first) doubled_.push_back(keys_[i].second);
  }
  for (const std::int32_t f : doubled_) mesh_.remove_face(f);
}

}  // namespace manip3d::quality_detail
