#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/simplify/depth_coverage.hpp"
#include "simplify/relief/surface.hpp"

namespace manip3d::relief_detail {

/// Pixels (u, v) of a face's corners, counter-clockwise with v up.
using Corner = std::array<std::int32_t, 2>;
using Corners = std::array<Corner, 3>;

/// A face over pixels without surface.
struct Bridge {
  double area;  ///< The area of the face over these pixels, estimated without slivers.
  Eigen::Index face;
};

/// Memory that is kept from frame to frame.
struct CoverageScratch {
  std::vector<std::uint8_t> covered;
  std::vector<std::int32_t> flaws;
  std::vector<std::uint8_t> filled;  ///< By pixel: whether it was filled; empty if none was.
  std::vector<float> depths;         ///< By pixel, if there are steps.
  std::vector<float> most;           ///< By pixel: the largest depth that is not a step behind it.
  std::vector<std::uint16_t> times;  ///< By pixel: number of faces that cover it.
  std::vector<Corners> corners;      ///< By face; all equal for faces that cover nothing.
  std::vector<Bridge> bridges;
  std::vector<std::int32_t> faces_at;  ///< By vertex: number of its faces.
};

/// Coverage of a mesh and of the same mesh without the faces that are off the surface.
struct CutCoverage {
  DepthCoverage whole, without_off;
};

/// depth_coverage() for an existing surface.
/// @param off  By face: whether it is excluded from `without_off`; may be empty: none is.
/// @param filled  (k, 2) column and row of filled pixels; see depth_coverage().
CutCoverage coverage_of(const Surface& surface,
                        const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                        const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                        std::span<const std::uint8_t> off,
                        const Eigen::Ref<const Rows<std::int32_t, 2>>& filled,
                        CoverageScratch& scratch);

/// Share of each face's pixels that are a step off it; see faces_off_surface().
std::vector<float> off_surface(const Surface& surface,
                               const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                               const Eigen::Ref<const Rows<std::int32_t, 3>>& faces);

/// Whether a triangle joins surfaces that a step separates: one of its sides crosses a step, and at
/// most half of the pixels over it have surface, or more than a quarter of those are a step off it.
/// across_steps() in _depth_steps.py leaves out faces by the same rule.
bool lies_off(const Surface& surface, const std::array<std::int32_t, 3>& pixels);

/// Number of pixels that a triangle covers, without its corners: pixels of the surface that are not
/// a step off it.
std::int64_t covered_pixels(const Surface& surface, const std::array<std::int32_t, 3>& pixels);

/// Counts, before each pixel in row-major order, the pixels whose cells are not complete.
void count_flaws(const Surface& surface, std::vector<std::int32_t>& flaws);

/// Estimated number of halves of cells without surface that a triangle lies over, without slivers
/// along contours.
/// @param flaws  Result of count_flaws().
std::int64_t bridged_halves(const Surface& surface, std::span<const std::int32_t> flaws,
                            const std::array<std::int32_t, 3>& pixels);

/// Leaves out the faces that are bridges rather than surface: more of their area lies over pixels
/// without surface than they alone cover of the surface, as shares of the whole. The largest
/// bridges are left out first, and each vertex keeps a face.
void remove_bridges(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                    Rows<std::int32_t, 3>& faces, CoverageScratch& scratch);

/// lies_off() for each face of a mesh, as 0 or 1; empty if there is no limit on steps.
void find_off(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
              const Eigen::Ref<const Rows<std::int32_t, 3>>& faces, std::vector<std::uint8_t>& off);

}  // namespace manip3d::relief_detail
