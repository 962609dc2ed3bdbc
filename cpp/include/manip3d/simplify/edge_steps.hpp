#pragma once

#include <cstdint>
#include <vector>

#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// A change of depth along an edge of a mesh is a step if it exceeds z * max(share, slope + noise *
/// z), where z is the smaller depth.
struct EdgeStepRule {
  double share = 0.0, slope = 0.0, noise = 0.0;
  /// Ignore edges that cross something and return to the same surface: the steps along the edge,
  /// counted with their signs, must add up to more than half of the difference between the ends.
  bool passing = false;
};

/// Find the faces of a mesh across steps; its vertices are pixels. The result is 1 for a face with
/// an edge whose end depths differ by a step, and along whose line of pixels the depth changes by a
/// step from one measured pixel to the next; else 0.
/// @param image   32-bit floats or integers in any unit; 0: no measurement.
/// @param pixels  (n, 2) column and row of each vertex.
/// @throws InputError  a pixel or an index out of range.
std::vector<std::uint8_t> faces_across_steps(const DepthView& image,
                                             const Eigen::Ref<const Rows<std::int32_t, 2>>& pixels,
                                             const Eigen::Ref<const Rows<std::int32_t, 3>>& faces,
                                             const EdgeStepRule& rule);

}  // namespace manip3d
