#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"

namespace manip3d {

/// The plane of a floor: normal.dot(p) = height.
struct FloorPlane {
  Eigen::Vector3f normal = Eigen::Vector3f::UnitY();  ///< Down.
  float height = 0.0F;                                ///< Metres below the camera.
  float noise = 0.0F;  ///< Root mean square distance of its points from the plane, metres.
};

/// Tells which way is down from the floor, over the frames of a camera that may be tilted.
///
/// The floor is what is level well below a person's hips and not a person: of many places in the
/// image the normal of the surface, and of those that may be a floor's the direction that most of
/// them share. A camera that sees too little floor is taken for one that stands upright.
///
/// The plane of the floor is that of the last frame that showed enough of it: fitted to the lowest
/// level surface, within two metres of the person where there is enough of it.
class Vertical {
 public:
  /// Learns from one frame: which way is down, and the floor's plane where enough of it is seen.
  /// @param body_index  (rows, cols) or null: then nobody is left out.
  /// @param hips  the middle of the person's hips in the camera's frame, metres.
  void learn(const DepthView& depth, const std::uint8_t* body_index, const PixelRays& rays,
             const Eigen::Vector3f& hips);

  /// Unit vector in the frame of the camera.
  [[nodiscard]] const Eigen::Vector3d& down() const { return down_; }

  /// Has a frame shown enough of a floor? Until then down() is along the image's columns.
  [[nodiscard]] bool is_known() const { return frames_ > 0.0; }

  /// None as long as no frame has shown enough of a floor.
  [[nodiscard]] const std::optional<FloorPlane>& floor() const { return floor_; }

  void reset() { *this = {}; }

 private:
  static constexpr std::size_t kMost = 2048;  // places of a frame that are looked at

  void find_floor(std::size_t count, const Eigen::Vector3f& now, const Eigen::Vector3f& hips);

  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  double frames_ = 0.0;
  std::optional<FloorPlane> floor_;
  // The memory for places of one frame.
  std::array<Eigen::Vector3f, kMost> normals_, points_;
  std::array<float, kMost> heights_;
};

}  // namespace manip3d
