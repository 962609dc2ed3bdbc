#pragma once

#include <optional>
#include <vector>

#include "manip3d/simplify/qem.hpp"
#include "simplify/collapse_mesh.hpp"
#include "simplify/constraints.hpp"

namespace manip3d {

/// cos 78 deg; at 90 degrees a face could turn over in two steps.
constexpr double kMinNormalCosine = 0.2;

/// Sine of an angle below which a face has no area, because its normal would be rounding noise.
constexpr double kMinSine = 1e-10;

/// Decides whether a collapse keeps the mesh valid: flips, degenerate and duplicate faces, link
/// condition, boundary loops, texture coordinates.
class Legality {
 public:
  Legality(const CollapseMesh& mesh, const QemOptions& options)
      : mesh_(mesh),
        options_(options),
        ring_v_(mesh.num_vertices()),
        ring_t_(mesh.num_vertices()) {}

  /// Returns why v must not collapse onto its neighbour t, if there is a reason. Fills `map` as
  /// CollapseMesh::map_wedges does.
  std::optional<Rejection> check(std::int32_t v, std::int32_t t, WedgeMap& map);

  /// The neighbours of v at the last check().
  [[nodiscard]] const Ring& ring() const { return ring_v_; }

 private:
  [[nodiscard]] bool keeps_texture() const {
    return options_.texture != TextureTerm::kNone && options_.texture != TextureTerm::kQuadric5;
  }
  [[nodiscard]] bool closes_boundary_loop(std::int32_t t) const;
  [[nodiscard]] bool needs_link_condition(std::int32_t v, std::int32_t t) const;
  [[nodiscard]] bool breaks_link_condition(std::int32_t t) const;
  [[nodiscard]] std::optional<Rejection> check_face(std::int32_t f, std::int32_t c, std::int32_t t,
                                                    const WedgeMap& map) const;
  [[nodiscard]] bool has_face(std::int32_t t, std::int32_t a, std::int32_t b) const;

  const CollapseMesh& mesh_;
  const QemOptions& options_;
  Ring ring_v_, ring_t_;
};

}  // namespace manip3d
