#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "manip3d/simplify/depth_coverage.hpp"
#include "simplify/relief_surface.hpp"

namespace manip3d::relief_detail {

struct CoverageScratch {
  std::vector<std::uint8_t> covered;
  std::vector<std::int32_t> flaws;
  struct Range {
    float depth = 0.0F, most = 0.0F;  ///< `most`: the largest depth that is no step behind it.
  };
  std::vector<Range> depths;  ///< By pixel, where there are steps.
};

/// Like depth_coverage(), for a surface that was built before.
DepthCoverage coverage_of(const Surface& surface,
                          const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                          const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                          CoverageScratch& scratch);

/// Share of each face's pixels that are a step off it; see faces_off_surface().
std::vector<float> off_surface(const Surface& surface,
                               const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                               const Eigen::Ref<const Rows<std::int32_t, 3>>& faces);

/// Does a triangle join what is apart? One of its sides crosses a step, and no more than half of
/// the pixels over it are seen, or more than a quarter of those lies a step off it. The rule by
/// which across_steps() in _depth_steps.py leaves faces out.
bool lies_off(const Surface& surface, const std::array<std::int32_t, 3>& pixels);

}  // namespace manip3d::relief_detail
