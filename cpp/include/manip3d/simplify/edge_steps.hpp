#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// Which change of depth along an edge of a mesh is a step: one above
/// z * max(share, slope + noise * z) for the lesser depth z.
struct EdgeStepRule {
  double share = 0.0, slope = 0.0, noise = 0.0;
  /// To cross something and come back to the same surface is not a step: the steps on the way,
  /// those down taken from those up, must make more than half of the difference of the ends.
  bool passing = false;
};

/// For each face of a mesh whose vertices are pixels: 1 if the depth at the ends of one of its
/// edges differs by a step, and on the line of pixels between them changes by a step from one
/// measured pixel to the next; else 0.
/// @param image   32-bit numbers, in any unit; 0: no measurement.
/// @param pixels  (n, 2) column and row of each vertex.
/// @throws InputError  a pixel or an index out of range.
std::vector<std::uint8_t> faces_across_steps(const DepthView& image,
                                             const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                             const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                             const EdgeStepRule& rule);

}  // namespace manip3d
