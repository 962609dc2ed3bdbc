#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// Tells which way is down from the floor, over the frames of a camera that may be tilted.
///
/// The floor is what is level well below a person's hips and not a person: of many places in the
/// image the normal of the surface, and of those that may be a floor's the direction that most of
/// them share. A camera that sees too little floor is taken for one that stands upright.
class Vertical {
 public:
  /// @param body_index  (rows, cols) or null: then nobody is left out.
  /// @param hips  of the person, metres.
  void learn(const DepthView& depth, const std::uint8_t* body_index, const PixelRays& rays,
             const Eigen::Vector3f& hips);

  /// Unit vector in the frame of the camera.
  [[nodiscard]] const Eigen::Vector3d& down() const { return down_; }

  void reset() { *this = {}; }

 private:
  static constexpr std::size_t kMost = 2048;

  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  double frames_ = 0.0;
  std::array<Eigen::Vector3f, kMost> normals_;  ///< The memory for those of one frame.
};

}  // namespace manip3d
