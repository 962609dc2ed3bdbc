#pragma once

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "simplify/collapse_rules.hpp"
#include "simplify/quality_original.hpp"

namespace manip3d::quality_detail {

/// Whether a collapse of two vertices is legal, by the rules of collapse_rules.hpp.
class CollapseCheck {
 public:
  /// @param may_double  Whether faces may be removed as duplicates; false with max_distance, whose
  ///                    guard does not track such removals.
  CollapseCheck(const CollapseMesh& mesh, const Kept& kept, bool may_double)
      : mesh_(mesh),
        kept_(kept),
        may_double_(may_double),
        ring_v_(mesh.num_vertices()),
        ring_t_(mesh.num_vertices()) {}

  [[nodiscard]] Rules rules() const { return rules_; }
  void set_rules(Rules rules) { rules_ = rules; }
  void relax() { rules_ = rules_ == Rules::kAll ? Rules::kAnyEdges : Rules::kFlips; }

  /// Selects two vertices for the functions below; returns their edge, or null if there is none.
  const RingEdge* look_at(std::int32_t v, std::int32_t t);

  /// The edges of the first and of the second vertex.
  [[nodiscard]] const Ring& first_ring() const { return ring_v_; }
  [[nodiscard]] const Ring& second_ring() const { return ring_t_; }

  [[nodiscard]] bool breaks_link() const;
  /// Whether a locked vertex would lose its last faces.
  [[nodiscard]] bool takes_last_face_of_locked() const;
  /// Returns why the two vertices must not be merged at p, if there is a reason.
  [[nodiscard]] std::optional<Rejection> check_faces(const Vector3d& p) const {
    return check_faces(p, rules_);
  }
  [[nodiscard]] std::optional<Rejection> check_faces(const Vector3d& p, Rules rules) const;
  /// Whether two faces may get the same vertices; one of them is removed then.
  [[nodiscard]] bool may_double() const { return may_double(rules_); }
  /// The neighbours of both vertices, possibly repeated, and the two vertices themselves.
  void neighbours(std::vector<std::int32_t>& out) const;

  /// The edges of one vertex; valid until another one is examined.
  const std::vector<RingEdge>& edges(std::int32_t v) {
    mesh_.gather_ring(v, ring_v_);
    return ring_v_.edges();
  }

  /// Returns why a vertex must not move to p on its own, if there is a reason.
  [[nodiscard]] std::optional<Rejection> check_move(std::int32_t v, const Vector3d& p) const;

 private:
  [[nodiscard]] bool has_complex_edge() const;
  [[nodiscard]] bool may_double(Rules rules) const {
    return may_double_faces(rules, may_double_ && has_complex_edge());
  }
  [[nodiscard]] std::int32_t count_faces(std::int32_t w, std::int32_t a, std::int32_t b) const;
  [[nodiscard]] std::optional<Rejection> check_face(std::int32_t from, std::int32_t a,
                                                    std::int32_t b, const Vector3d& p,
                                                    Rules rules) const;

  const CollapseMesh& mesh_;
  const Kept& kept_;
  bool may_double_;
  Rules rules_ = Rules::kAll;
  std::int32_t v_ = -1, t_ = -1;
  Ring ring_v_, ring_t_;
};

/// Removes faces that are duplicates after a collapse.
class DoubledFaces {
 public:
  explicit DoubledFaces(CollapseMesh& mesh) : mesh_(mesh) {}

  /// Called before the collapse: finds faces of v or of t that lie back to back, which stay
  /// allowed.
  void find_twins(std::int32_t v, std::int32_t t);
  /// Called after it: of faces on the same three vertices, keeps the first one in t's list; of
  /// twins, the first one on each side.
  void remove(std::int32_t t);

 private:
  CollapseMesh& mesh_;
  std::vector<Side> sides_, twins_;
  std::vector<std::pair<Side, std::int32_t>> keys_;
  std::vector<std::int32_t> doubled_;
};

}  // namespace manip3d::quality_detail
