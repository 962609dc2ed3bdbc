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
  Eigen::Vector3f normal = Eigen::Vector3f::UnitY();  ///< Downwards.
  float height = 0.0F;                                ///< Metres below the camera.
  float noise = 0.0F;  ///< Root mean square distance of the floor's points from the plane, metres.
};

/// Estimates the vertical from the floor, over the frames of a camera that may be tilted.
///
/// The floor is any level surface well below a person's hips that is not a person. Normals of the
/// surface are computed at many places of the image; of those that may belong to a floor, the
/// direction on which most agree is the vertical. Until a camera has seen enough floor, it is
/// assumed to be level.
///
/// The plane of the floor is that of the last frame that showed enough of it. It is fitted to the
/// lowest level surface, within two metres of the person if there are enough points.
class Vertical {
 public:
  /// Updates the vertical with one frame, and the plane of the floor if enough of it is visible.
  /// @param body_index  (rows, cols); null: no pixels are left out.
  /// @param hips        The middle of the person's hips in the camera frame, metres.
  void learn(const DepthView& depth, const std::uint8_t* body_index, const PixelRays& rays,
             const Eigen::Vector3f& hips);

  /// Unit vector in the camera frame.
  [[nodiscard]] const Eigen::Vector3d& down() const { return down_; }

  /// Whether a frame has shown enough of a floor. Until then down() is along the image's columns.
  [[nodiscard]] bool is_known() const { return frames_ > 0.0; }

  /// No value before the first frame that shows enough of a floor.
  [[nodiscard]] const std::optional<FloorPlane>& floor() const { return floor_; }

  void reset() { *this = {}; }

 private:
  static constexpr std::size_t kMost = 2048;  // largest number of sampled pixels per frame

  void find_floor(std::size_t count, const Eigen::Vector3f& now, const Eigen::Vector3f& hips);

  Eigen::Vector3d down_ = Eigen::Vector3d::UnitY();
  double frames_ = 0.0;
  std::optional<FloorPlane> floor_;
  // Memory for the sampled pixels of one frame.
  std::array<Eigen::Vector3f, kMost> normals_, points_;
  std::array<float, kMost> heights_;
};

}  // namespace manip3d
