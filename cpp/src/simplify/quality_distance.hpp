#pragma once

#include <cstdint>
#include <functional>
#include <initializer_list>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "simplify/distance_guard.hpp"
#include "simplify/quality_original.hpp"

namespace manip3d::quality_detail {

/// Asks the guard of max_distance before each change of the mesh. Without a limit, all changes are
/// allowed.
class WithinDistance {
 public:
  WithinDistance(const MeshView& input, const CollapseMesh& mesh, double limit,
                 std::function<void()> on_proof);

  [[nodiscard]] bool has_limit() const { return guard_.has_value(); }
  [[nodiscard]] std::optional<double> bound() const;

  /// Whether v and t may both move to p; if so, the guard records the change. A failed proof is not
  /// repeated until something changes.
  [[nodiscard]] bool allows_collapse(std::int32_t v, std::int32_t t, const Vector3d& p);
  /// Whether v may move to p; if so, the guard records the change.
  [[nodiscard]] bool allows_move(std::int32_t v, const Vector3d& p);

 private:
  bool allows(std::initializer_list<std::int32_t> moving, const Vector3d& p);

  const CollapseMesh& mesh_;
  std::optional<DistanceGuard> guard_;
  // Edges refused since the last collapse, because an edge with two blocked ends is queued twice.
  std::set<std::pair<std::int32_t, std::int32_t>> refused_;
  std::vector<std::int32_t> touched_, around_;
  std::vector<DistanceGuard::Change> changed_;
};

}  // namespace manip3d::quality_detail
