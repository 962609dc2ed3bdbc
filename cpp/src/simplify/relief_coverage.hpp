#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "manip3d/simplify/depth_coverage.hpp"
#include "simplify/relief_surface.hpp"

namespace manip3d::relief_detail {

struct CoverageScratch {
  std::vector<std::uint8_t> covered;
  std::vector<std::int32_t> flaws;
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

}  // namespace manip3d::relief_detail
