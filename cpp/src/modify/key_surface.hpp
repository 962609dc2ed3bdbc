#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include "manip3d/geometry/camera.hpp"
#include "manip3d/geometry/depth_image.hpp"
#include "manip3d/modify/segmentation.hpp"
#include "modify/phantom_image.hpp"
#include "modify/trunk_pose.hpp"

/// @file
/// The surface of a trunk in a key frame, and its comparison with a depth image.
namespace manip3d {

/// With fewer points, a surface is not used.
inline constexpr std::size_t kMinSurface = 60;
inline constexpr double kSurfaceScale = 0.02;  ///< Scale of the Geman-McClure weight, metres.
/// The noise of neighbouring points is correlated, so that 500 points are worth about thirty
/// independent ones: the noise of a point is multiplied by four to get the right noise of all.
inline constexpr double kSharedNoise = 4.0;

/// Distance of the depth image from a point of a surface, along the normal of the surface.
struct SurfaceResidual {
  double off = 0.0;    ///< Metres.
  double share = 1.0;  ///< The Geman-McClure weight is 1 / share^2.
  /// Whether the distance is below sqrt(3) times the scale; there the weight is 1 / 16.
  [[nodiscard]] bool agrees() const { return std::abs(off) < std::numbers::sqrt3 * kSurfaceScale; }
  [[nodiscard]] double weight(double noise) const { return 1.0 / (noise * noise * share * share); }
};

/// The depth image of a frame with the rays of its pixels. Borrows both.
class SeenDepth {
 public:
  SeenDepth(const DepthView& depth, const PixelRays& rays, const Intrinsics& camera)
      : depth_(&depth), rays_(&rays), projector_(camera, rays) {}

  /// Residual at the pixel that a point projects to; no value without a measurement there.
  [[nodiscard]] std::optional<SurfaceResidual> residual_at(const Eigen::Vector3d& p,
                                                           const Eigen::Vector3d& normal,
                                                           double scale = kSurfaceScale) const;

  /// Return the normal, towards the camera, of the least-squares plane z = a x + b y + c through
  /// the points around a pixel; no value on edges.
  /// @param is_arm  By pixel: whether it belongs to an arm. Such pixels do not count: an arm that
  ///                hangs a few centimetres in front would turn the normals of the trunk beside it.
  [[nodiscard]] std::optional<Eigen::Vector3d> normal_at(
      std::int32_t pixel, std::span<const std::uint8_t> is_arm) const;

 private:
  const DepthView* depth_;
  const PixelRays* rays_;
  PixelProjector projector_;
};

/// Points of a trunk, in the coordinates of a trunk that is not twisted.
class KeySurface {
 public:
  struct Point {
    Eigen::Vector3d place, normal;  ///< In coordinates of the untwisted trunk.
    double share = 0.0;             ///< Share of the pelvis's turn by which the point turns.
  };
  /// The part of the trunk within its joints, metres, in coordinates of the trunk.
  struct Extent {
    double low = 0.0, high = 0.0;
    double half = 0.17;  ///< Half of its width; at least that of a narrow adult.
  };
  /// Agreement of the key frame with the visible surface.
  struct Agreement {
    std::size_t points = 0;
    double off = 0.0;  ///< Sum of their distances, metres.
  };

  KeySurface();

  [[nodiscard]] std::span<const Point> points() const { return points_; }
  [[nodiscard]] bool is_known() const { return points_.size() >= kMinSurface; }
  /// Noise of the distance of a pixel from the key frame, metres.
  [[nodiscard]] double noise() const;

  /// Whether another key frame is needed, because the trunk has turned too far or too little of the
  /// key frame is visible.
  [[nodiscard]] bool is_outdated(const TrunkPose& pose) const;
  /// Replaces the points by those of a person that lie on the trunk and not beside it. If there are
  /// too few, the old points stay, so that a frame without depth does not discard them.
  /// @param pelvis_turn  Turn of the pelvis, radians; not used for an arm.
  /// @return  Whether the points were replaced.
  bool renew(const PersonPoints& person, const SeenDepth& seen, const TrunkPose& pose,
             const Extent& extent, bool is_arm, double pelvis_turn);

  /// Updates the share of visible points and the mean residual with a frame.
  void learn(const Agreement& agreed);

  void reset();

 private:
  std::vector<Point> points_;
  std::vector<std::uint8_t> is_arm_;  ///< By pixel; memory of renew().
  Eigen::Quaterniond key_rotation_ = Eigen::Quaterniond::Identity();
  double residual_ = 0.0;  ///< Mean distance of the visible surface from the key frame, metres.
  double share_ = 0.0;     ///< Share of the points that agreed in the last frame.
};

}  // namespace manip3d
