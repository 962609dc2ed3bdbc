// Readings of chapter 3 other than the default one; `manip3d reproduce readings-3` shows how much
// the results depend on them.
#include <cmath>

#include "simplify/importance_rows.hpp"

namespace manip3d {

using Stencil = Cs3Reading::Stencil;
using BesideInvalid = Cs3Reading::BesideInvalid;
using Rounding = Cs3Reading::Rounding;

void area_row_by(const Cs3Reading& reading, const PointRow& above, const PointRow& row,
                 const PointRow& below, std::int64_t width, float* area) {
  const bool backward = reading.beside_invalid == BesideInvalid::kBackward;
  const float unknown = reading.beside_invalid == BesideInvalid::kUnknown
                            ? std::numeric_limits<float>::quiet_NaN()
                            : 0.0F;
  for (std::int64_t u = 0; u < width; ++u) {
    const bool from_left = backward && std::isnan(row.z[u + 1] - row.z[u]);
    const bool from_above = backward && std::isnan(below.z[u] - row.z[u]);
    const auto across = [&](const float* p) {
      return from_left ? p[u] - p[u - 1] : p[u + 1] - p[u];
    };
    const auto down = [&](const float* before, const float* p, const float* after) {
      return from_above ? p[u] - before[u] : after[u] - p[u];
    };
    const float a =
        area_of(across(row.x), across(row.y), across(row.z), down(above.x, row.x, below.x),
                down(above.y, row.y, below.y), down(above.z, row.z, below.z));
    area[u] = a < kInfinityF ? a : unknown;
  }
}

Hessian hessian_by(const Cs3Reading& reading, const AreaRows& a, std::int64_t u) {
  const float center = a.row[u], left = a.row[u - 1], right = a.row[u + 1];
  const float upper = a.up[u], lower = a.down[u];
  const float left2 = a.row[u - 2], right2 = a.row[u + 2], upper2 = a.up2[u], lower2 = a.down2[u];
  const float lower_right = a.down[u + 1], lower_left = a.down[u - 1];
  const float upper_right = a.up[u + 1], upper_left = a.up[u - 1];
  const float cross = lower_right - lower_left - upper_right + upper_left;
  const float middle = 2.0F * center;
  switch (reading.stencil) {
    case Stencil::kGradientOfGradient:
      // All values are multiplied by 4.
      return {right2 - middle + left2, lower2 - middle + upper2, cross};
    case Stencil::kCompact:
      return {right - middle + left, lower - middle + upper, 0.25F * cross};
    case Stencil::kForward:
      return {right2 - 2.0F * right + center, lower2 - 2.0F * lower + center,
              lower_right - right - lower + center};
    case Stencil::kSobel:
      break;
  }
  const float corners = lower_right + lower_left + upper_right + upper_left;
  const float sides_u = right + left, sides_v = lower + upper;
  return {corners + 2.0F * (sides_u - sides_v) - 4.0F * center,
          corners + 2.0F * (sides_v - sides_u) - 4.0F * center, cross};
}

void importance_row_by(const Cs3Options& options, const AreaRows& areas, const float* z,
                       std::int64_t width, ImportanceKey* keys) {
  for (std::int64_t u = 0; u < width; ++u) {
    const Hessian m = hessian_by(options.reading, areas, u);
    keys[u] = options.importance == Cs3Importance::kMinCurvature
                  ? key_of<Cs3Importance::kMinCurvature>(m, z[u])
                  : key_of<Cs3Importance::kLaplacian>(m, z[u]);
  }
}

std::int64_t rounded_by(Rounding rounding, double radius) {
  if (rounding == Rounding::kNearest) radius += 0.5;
  const auto r = static_cast<std::int64_t>(radius);
  return rounding == Rounding::kUp && static_cast<double>(r) < radius ? r + 1 : r;
}

}  // namespace manip3d
