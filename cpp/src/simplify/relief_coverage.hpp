#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "manip3d/simplify/depth_coverage.hpp"
#include "simplify/relief_surface.hpp"

namespace manip3d::relief_detail {

/// Pixels (u, v) of a face's corners, counter-clockwise with v up.
using Corner = std::array<std::int32_t, 2>;
using Corners = std::array<Corner, 3>;

/// A face over pixels without surface.
struct Bridge {
  double area;  ///< The area of the face over these.
  Eigen::Index face;
};

/// Memory that is kept from frame to frame.
struct CoverageScratch {
  std::vector<std::uint8_t> covered;
  std::vector<std::int32_t> flaws;
  std::vector<float> depths;         ///< By pixel, where there are steps.
  std::vector<float> most;           ///< By pixel: the largest depth that is no step behind it.
  std::vector<std::uint16_t> times;  ///< By pixel: how many faces cover it.
  std::vector<Corners> corners;      ///< By face; of faces that cover nothing, all are equal.
  std::vector<Bridge> bridges;
  std::vector<std::int32_t> faces_at;  ///< By vertex: number of its faces.
};

/// Coverage of a mesh and of the same mesh without the faces that are off the surface.
struct CutCoverage {
  DepthCoverage whole, without_off;
};

/// Like depth_coverage(), for a surface that was built before.
/// @param off  by face: whether it is left out of `without_off`; may be empty: none is.
CutCoverage coverage_of(const Surface& surface,
                        const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                        const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                        std::span<const std::uint8_t> off, CoverageScratch& scratch);

/// Share of each face's pixels that are a step off it; see faces_off_surface().
std::vector<float> off_surface(const Surface& surface,
                               const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                               const Eigen::Ref<const Rows<std::int32_t, 3>>& faces);

/// Does a triangle join what is apart? One of its sides crosses a step, and no more than half of
/// the pixels over it are seen, or more than a quarter of those lies a step off it. The rule by
/// which across_steps() in _depth_steps.py leaves faces out.
bool lies_off(const Surface& surface, const std::array<std::int32_t, 3>& pixels);

/// How many pixels a triangle covers, its corners aside: those of the surface that are no step off
/// it.
std::int64_t covered_pixels(const Surface& surface, const std::array<std::int32_t, 3>& pixels);

/// Leaves out the faces of a mesh that are bridges rather than surface: more of their area lies
/// over pixels without surface than they alone cover of the surface, as shares of the whole. Those
/// with the largest bridges go first, and each vertex keeps a face.
void remove_bridges(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                    Rows<std::int32_t, 3>& faces, CoverageScratch& scratch);

/// lies_off() for each face of a mesh, as 0 or 1; empty if there is no limit on steps.
void find_off(const Surface& surface, const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
              const Eigen::Ref<const Rows<std::int32_t, 3>>& faces, std::vector<std::uint8_t>& off);

}  // namespace manip3d::relief_detail
